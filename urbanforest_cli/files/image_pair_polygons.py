"""The truth of images out of one layer of polygons."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core import crs as core_crs
from urbanforest_cli.core.errors import CrsError, InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.coverage_truth import rasterised
from urbanforest_cli.files.image_pair_blocks import Block, Image
from urbanforest_cli.files.vectors import read_vector, split_source


class PolygonTruth:
    """Polygons in the CRS of every image they are drawn on.

    Parameters
    ----------
    source
        ``FILE[:LAYER]``.
    images
        Each must lie somewhere; images that no polygon touches are left to the caller, see `touches`.

    Raises
    ------
    InputError
        The file cannot be used, an image lies nowhere, or no polygon touches any image.
    """

    def __init__(self, source: Path, images: Sequence[Image], *, assume_crs: str | None, notices: Notices) -> None:
        path, layer = split_source(str(source))
        frame = read_vector(path, layer=layer, columns=(), kinds=("polygon",), assume_crs=assume_crs, notices=notices)
        shapes = frame.geometry.to_numpy()
        shapes = shapes[np.isfinite(shapely.bounds(shapes)).all(axis=1)]
        notices.add("W_TRUTH_EMPTY", "polygons of the truth without a place", len(frame) - len(shapes))
        broken = ~shapely.is_valid(shapes)
        notices.add("W_TRUTH_REPAIRED", "polygons of the truth that were repaired", int(broken.sum()))
        shapes[broken] = shapely.make_valid(shapes[broken])
        shapes = shapely.get_parts(shapely.get_parts(shapes))
        shapes = shapes[shapely.get_type_id(shapes) == shapely.GeometryType.POLYGON]
        self._by_crs: dict[str, tuple[NDArray[np.object_], shapely.STRtree]] = {}
        for image in images:
            if image.grid is None:
                raise CrsError("polygons cannot be laid on an image without a place on the map",
                               where=image.files.image, next_step="georeference it, or draw masks")  # fmt: skip
            key = image.grid.crs.to_wkt()
            if key not in self._by_crs:
                moved = core_crs.reproject(shapes, CRS.from_user_input(frame.crs), image.grid.crs)
                self._by_crs[key] = moved, shapely.STRtree(moved)
        if not any(self.touches(image) for image in images):
            raise InputError("no polygon lies on any image", where=source, found=f"{len(shapes)} polygons",
                             next_step="check their CRS, and that both are of one place")  # fmt: skip

    def touches(self, image: Image) -> bool:
        """Tell whether any polygon reaches onto an image."""
        assert image.grid is not None
        _, tree = self._by_crs[image.grid.crs.to_wkt()]
        return len(tree.query(shapely.box(*image.grid.bounds), predicate="intersects")) > 0

    def truth(self, block: Block) -> NDArray[np.uint8]:
        """Return the share of each pixel that polygons cover, (1, row, col) in percent."""
        assert block.image.grid is not None
        shapes, tree = self._by_crs[block.image.grid.crs.to_wkt()]
        return rasterised(shapes, tree, block.image.grid.window(*block.window))[None]
