"""Pictures as PNG bytes: with their provenance inside, or small enough for a page."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

from urbanforest_cli import __version__
from urbanforest_cli.export.text import boxes_for_unknown_letters

PAGE_PX = 1800
PAGE_COLOURS = 256


def png_of(figure: Figure, provenance: Mapping[str, Any] | None = None) -> bytes:
    """Return a figure as PNG, with its provenance as JSON in the text chunk ``urbanforest``."""
    stream = io.BytesIO()
    metadata = {"Software": f"urbanforest {__version__}"}
    if provenance:
        metadata["urbanforest"] = json.dumps(provenance, ensure_ascii=True)
    with boxes_for_unknown_letters():
        figure.savefig(stream, format="png", dpi=figure.dpi, metadata=metadata)
    return stream.getvalue()


def for_page(png: bytes) -> bytes:
    """Return a picture small enough for the page: narrower, and of few colours."""
    picture: Image.Image = Image.open(io.BytesIO(png))
    if picture.width > PAGE_PX:
        size = (PAGE_PX, round(picture.height * PAGE_PX / picture.width))
        picture = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    return _fewer_colours(picture)


def _fewer_colours(picture: Image.Image) -> bytes:
    stream = io.BytesIO()
    reduced = picture.convert("RGB").quantize(PAGE_COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    reduced.save(stream, format="PNG", optimize=True)
    return stream.getvalue()
