"""Coverage models of a few numbers, whose answers are known by hand, and images to show them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from urbanforest_cli.core.coverage_model import FORMAT, INPUT_NAME, OUTPUT_NAME, CoverageModelInfo
from urbanforest_cli.core.onnx_bytes import sealed

GAIN = 20.0
PLACE = (0.6, 0.0, 400_000.2, 0.0, -0.6, 3_700_000.8)


def info_of(classes=("canopy", "vegetation"), *, multiple_px=1, halo_px=0, resolution_m=0.6, mean=127.5):
    return CoverageModelInfo(
        classes=classes,
        resolution_m=resolution_m,
        multiple_px=multiple_px,
        halo_px=halo_px,
        channel_mean=(mean,) * 3,
        channel_scale=(127.5,) * 3,
        thresholds=(0.4, 0.5)[: len(classes)],
        preset="small",
        program_version="0",
    )


def greenness(info):
    """A pixel's own colours and nothing else: canopy where green is above red, vegetation where above blue."""
    weight = np.zeros((2, 3, 1, 1), np.float32)
    weight[:, 1] = GAIN
    weight[0, 0], weight[1, 2] = -GAIN, -GAIN
    return _model(info, [("Conv", {}, weight)])


def greenness_of(rgb):
    """What `greenness` answers."""
    red, green, blue = rgb.astype(np.float64) / 127.5
    return 1 / (1 + np.exp(-GAIN * np.stack([green - red, green - blue])))


def wide(info):
    """What shrinks by 4, looks around and grows again, so that it depends on where tiles begin and end."""
    rng = np.random.default_rng(3)
    return _model(
        info,
        [
            ("Conv", {"pads": [1] * 4}, rng.normal(0, 0.5, (4, 3, 3, 3))),
            ("Conv", {"strides": [4, 4]}, rng.normal(0, 0.4, (4, 4, 4, 4))),
            ("Conv", {"pads": [1] * 4}, rng.normal(0, 0.5, (4, 4, 3, 3))),
            ("ConvTranspose", {"strides": [4, 4]}, rng.normal(0, 0.8, (4, 2, 4, 4))),
        ],
    )


WIDE_STEP, WIDE_HALO = 4, 5  # the coarse cell beside a block, and the pixel beside that


def _model(info, layers):
    onnx = pytest.importorskip("onnx")
    helper = onnx.helper
    nodes, weights, name = [], [], INPUT_NAME
    for index, (kind, settings, weight) in enumerate(layers):
        weights.append(onnx.numpy_helper.from_array(np.asarray(weight, np.float32), f"w{index}"))
        nodes.append(helper.make_node(kind, [name, f"w{index}"], [f"x{index}"], **settings))
        name = f"x{index}"
    nodes.append(helper.make_node("Sigmoid", [name], [OUTPUT_NAME]))

    def value(called, channels):
        shape = ["batch", channels, f"{called}_row", f"{called}_col"]
        return helper.make_tensor_value_info(called, onnx.TensorProto.FLOAT, shape)

    graph = helper.make_graph(nodes, FORMAT, [value(INPUT_NAME, 3)], [value(OUTPUT_NAME, len(info.classes))], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return sealed(model.SerializeToString(), info.as_metadata())


def garden(height_px, width_px, seed=1):
    """Smooth lumps of green on gray, (3, row, col)."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:height_px, :width_px]
    lumps = sum(
        np.exp(-((rows - r) ** 2 + (cols - c) ** 2) / (2 * s**2))
        for r, c, s in zip(
            rng.uniform(0, height_px, 40), rng.uniform(0, width_px, 40), rng.uniform(3, 14, 40), strict=True
        )
    )
    green = np.clip(lumps, 0, 1)
    rgb = np.stack([150 - 90 * green, 145 - 20 * green, 140 - 80 * green]) + rng.normal(0, 6, (3, height_px, width_px))
    return np.clip(rgb, 1, 255).astype(np.uint8)


def write_image(path: Path, values, *, transform=PLACE, crs="EPSG:26911", colours=("red", "green", "blue"), **more):
    """A tiled GeoTIFF of (band, row, col)."""
    bands, height, width = values.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=height, width=width, count=bands, dtype=values.dtype, crs=crs,
        transform=rasterio.Affine(*transform), tiled=True, blockxsize=64, blockysize=64, compress="DEFLATE", **more,
    ) as file:  # fmt: skip
        file.write(values)
        file.colorinterp = [rasterio.enums.ColorInterp[name] for name in colours]
    return path
