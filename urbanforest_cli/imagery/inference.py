"""A coverage model at work: images in, probabilities out, on the processor and always the same."""

from __future__ import annotations

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import INPUT_NAME, OUTPUT_NAME, CoverageModelInfo
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.imagery.window_cells import WindowCells, gather, paint, tile_cells
from urbanforest_cli.imagery.windows import Plane, plane_of

TILE_CELLS, CORE_LEAST_CELLS = 512, 384
"""Cells along a side that the network is given at once, and that a window keeps however wide its halo is.

Larger tiles are no faster: what a network holds in between leaves the processor's caches.
"""


class CoverageSession:
    """A loaded model.

    Parameters
    ----------
    content
        The ONNX file.
    info
        What it says of itself.
    threads
        That one run of the network may use; several threads may run the same session at once.

    Raises
    ------
    InputError
        The runtime does not take the model.
    """

    def __init__(self, content: bytes, info: CoverageModelInfo, *, threads: int = 1) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 4
        options.use_deterministic_compute = True
        options.enable_mem_pattern = False  # the plan of one shape would take half as much again, at the same speed
        self.info = info
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the runtime's classes of errors share no parent but this one
            raise InputError(
                "the runtime does not take this model", found=str(error).splitlines()[0], next_step="train it again"
            ) from error
        self._mean = np.array(info.channel_mean, np.float32)[:, None, None]
        self._scale = np.array(info.channel_scale, np.float32)[:, None, None]

    def run(self, cells: NDArray[np.float32]) -> NDArray[np.float32]:
        """Give the network (3, row, col) red, green, blue of 0-255; return (class, row, col) probabilities.

        Both sides must be multiples of `info.multiple_px`.

        Raises
        ------
        InputError
            The network failed, or its output has another shape than it should.
        """
        fed = np.ascontiguousarray((cells - self._mean) / self._scale, np.float32)[None]
        try:
            result = np.asarray(self._session.run([OUTPUT_NAME], {INPUT_NAME: fed})[0])
        except Exception as error:  # see above
            raise InputError(
                "the model failed", found=str(error).splitlines()[0], next_step="train it again"
            ) from error
        expected = (1, len(self.info.classes), *cells.shape[1:])
        if result.shape != expected or result.dtype != np.float32:
            raise InputError(
                "the model's output has another shape than it says", found=f"{result.dtype} {result.shape}",
                expected=f"float32 {expected}",
            )  # fmt: skip
        return np.asarray(result[0], np.float32)

    def predict(self, rgb: NDArray[np.uint8], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Return the probabilities of an image at the model's own resolution.

        Parameters
        ----------
        rgb, valid
            (3, row, col) 0-255 and (row, col), of any size from 1 pixel on.

        Returns
        -------
        (class, row, col) float32
            0 to 1, NaN where the image is not valid.
        """
        return predict_at(self, rgb, valid, (self.info.resolution_m, self.info.resolution_m))


def predict_at(
    session: CoverageSession, rgb: NDArray[np.uint8], valid: NDArray[np.bool_], resolution_m: tuple[float, float]
) -> NDArray[np.float32]:
    """Return the probabilities of a whole image in memory, pixel by pixel, whatever its resolution.

    Parameters
    ----------
    rgb, valid
        (3, row, col) 0-255 and (row, col).
    resolution_m
        Width and height of a pixel on the ground; it is brought to the model's and back.

    Returns
    -------
    (class, row, col) float32
        0 to 1, NaN where the image is not valid.
    """
    height, width = valid.shape
    plane = model_plane(session.info, (height, width), (0, 0), resolution_m)
    result = np.full((len(session.info.classes), height, width), np.nan, np.float32)

    def read(rows: range, cols: range) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        there = (slice(rows.start, rows.stop), slice(cols.start, cols.stop))
        return rgb[:, there[0], there[1]], valid[there]

    for rows, cols in plane.windows(core_cells(session.info)):
        window = gather(plane, rows, cols, read)
        if window.valid.any():
            there = (slice(rows.write.start, rows.write.stop), slice(cols.write.start, cols.write.stop))
            result[:, there[0], there[1]] = predict_window(session, plane, window)
    return result


def model_plane(
    info: CoverageModelInfo, size_px: tuple[int, int], first_px: tuple[int, int], resolution_m: tuple[float, float]
) -> Plane:
    """Lay a model's cells over an image; see `windows.plane_of`."""
    return plane_of(
        size_px, first_px, resolution_m,
        cell_m=info.resolution_m, multiple_px=info.multiple_px, halo_px=info.halo_px,
    )  # fmt: skip


def core_cells(info: CoverageModelInfo) -> int:
    """Return how many cells along a side a window keeps of its tile, a multiple of the model's step."""
    return -(-max(TILE_CELLS - 2 * info.halo_px, CORE_LEAST_CELLS) // info.multiple_px) * info.multiple_px


def predict_window(session: CoverageSession, plane: Plane, window: WindowCells) -> NDArray[np.float32]:
    """Return the probabilities of a window's pixels, (class, row, col) float32, NaN where they are not valid."""
    info = session.info
    cells, known = tile_cells(plane, window, multiple_px=info.multiple_px, fill=info.channel_mean)
    return paint(plane, window, session.run(cells), known)
