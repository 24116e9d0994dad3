"""Measure maps from images: megapixels a second on one core, against PyTorch, Pix2Pix and int8, and peak memory.

Speeds are of one thread, the median of several runs in turn, so that ratios hold within the run; times are this
machine's. A megapixel a second counts what is kept, its halo paid for. The network is the one that comes with the
program, or one of its shape with weights drawn by chance where there is none: that costs the same.
"""

from __future__ import annotations

import json
import logging
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.windows import Window

from urbanforest_cli.core.coverage_model import CLASSES, INPUT_NAME, CoverageModelInfo
from urbanforest_cli.core.onnx_bytes import sealed
from urbanforest_cli.files.coverage_models import SHIPPED, load_coverage_model
from urbanforest_cli.imagery.inference import CoverageSession, core_cells
from urbanforest_cli.imagery.learning.settings import SMALL

SIDE_PX = int(os.environ.get("BENCH_IMAGE_PX", "20000"))
SHARE = int(os.environ.get("BENCH_IMAGE_SHARE", "8"))
"""One in so many blocks of the large image has pixels; 1 maps all of it, which takes minutes."""
RUNS = 5
CHUNK_PX = 512
COVER = """
import json, resource, sys, time
from pathlib import Path
from urbanforest_cli.imagery.stage import cover_image
image, model, output, workers = sys.argv[1:]
started = time.perf_counter()
summary = cover_image([Path(image)], Path(output), model=Path(model), workers=int(workers))
usage = resource.getrusage(resource.RUSAGE_SELF)
peak_kb = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps([time.perf_counter() - started, usage.ru_utime + usage.ru_stime, peak_kb / 1024]))
"""


def main() -> None:
    import torch

    from urbanforest_cli.imagery.learning.network import NetworkShape, build_generator, frozen, probabilities

    torch.set_num_threads(1)
    model = _model()
    content, info = model if model is not None else _drawn()
    told = info.training.get("settings", {})
    small = NetworkShape(
        kind="small", class_count=len(info.classes), filters=told.get("filters", SMALL.filters),
        downs=told.get("downs", SMALL.downs),
    )  # fmt: skip
    network = frozen(build_generator(small, seed=1))
    core = core_cells(info)
    side = core + 2 * info.halo_px
    cells = _picture(side, side)
    session = CoverageSession(content, info)
    fed = ((cells - 127.5) / 127.5)[None]
    eight = _quantised(content, info)
    quick = CoverageSession(eight, info)
    found = _medians(
        {
            "onnxruntime": lambda: session.run(cells),
            "PyTorch, same shape": lambda: probabilities(network, fed),
            "onnxruntime, int8": lambda: quick.run(cells),
        }
    )
    kept = core**2 / 1e6
    name = "weights drawn by chance" if model is None else info.preset
    print(f"small network ({name}, {len(content) / 1e6:.1f} MB), windows of {core} px, halo {info.halo_px} px")
    for what, seconds in found.items():
        ratio = seconds / found["onnxruntime"]
        print(f"  {what:<22} {kept / seconds:6.2f} Mpx/s a core  {ratio:6.2f} x the time of onnxruntime", flush=True)
    full, less = session.run(cells), quick.run(cells)
    limits = np.array(info.thresholds)[:, None, None]
    apart = np.mean((full >= limits) != (less >= limits), axis=(1, 2))
    print(f"  int8: {len(eight) / 1e6:.1f} MB, other labels in {100 * apart.max():.2f} % of the pixels")
    _pix2pix(kept / found["onnxruntime"])
    _large_image(content, info)


def _model() -> tuple[bytes, CoverageModelInfo] | None:
    """Return the model of BENCH_MODEL, or the one that comes with the program."""
    named = os.environ.get("BENCH_MODEL")
    if named is None and not SHIPPED.is_file():
        return None
    model = load_coverage_model(Path(named) if named else None)
    return model.content, model.info


def _drawn() -> tuple[bytes, CoverageModelInfo]:
    """Return a model of the small network with weights drawn by chance."""
    from urbanforest_cli.imagery.learning.network import NetworkShape, build_generator

    shape = NetworkShape(kind="small", class_count=len(CLASSES), filters=SMALL.filters, downs=SMALL.downs)
    info = _info(shape.multiple_px, halo_px=3 * shape.multiple_px)
    return _exported(build_generator(shape, seed=1), info), info


def _pix2pix(small_mpx: float) -> None:
    """Time the generator of Pix2Pix as published, of 54 million parameters."""
    from urbanforest_cli.imagery.learning.network import NetworkShape, build_generator

    shape = NetworkShape(kind="pix2pix", class_count=len(CLASSES), filters=64, downs=8)
    info = _info(shape.multiple_px, halo_px=256, preset="pix2pix")
    session = CoverageSession(_exported(build_generator(shape, seed=1), info), info)
    core = core_cells(info)
    cells = _picture(core + 2 * info.halo_px, core + 2 * info.halo_px)
    seconds = _medians({"pix2pix": lambda: session.run(cells)}, runs=3)["pix2pix"]
    rate, raw = core**2 / 1e6 / seconds, cells[0].size / 1e6 / seconds
    print(f"Pix2Pix generator, halo {info.halo_px} px: {rate:.3f} Mpx/s a core ({raw:.2f} with the halo counted); "
          f"the small network is {small_mpx / rate:.0f} times as fast", flush=True)  # fmt: skip


def _large_image(content: bytes, info: CoverageModelInfo) -> None:
    """Map a large image in a process of its own and tell its peak memory."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "model.onnx").write_bytes(content)
        mapped = _write_large(folder / "image.tif") / 1e6
        for workers in (1, 2):
            arguments = [
                str(folder / "image.tif"),
                str(folder / "model.onnx"),
                str(folder / f"{workers}.tif"),
                str(workers),
            ]
            done = subprocess.run([sys.executable, "-c", COVER, *arguments], capture_output=True, text=True, check=True)
            wall, spent, memory_mb = json.loads(done.stdout)
            print(f"cover, {SIDE_PX:,} x {SIDE_PX:,} px, {mapped:.0f} Mpx of them there, {workers} workers: "
                  f"{wall:.0f} s, {spent:.0f} CPU s, peak {memory_mb:.0f} MB", flush=True)  # fmt: skip


def _write_large(path: Path) -> float:
    """Write the image; return how many of its pixels are there."""
    tile, mapped = _picture(CHUNK_PX, CHUNK_PX).astype(np.uint8), 0.0
    with rasterio.open(
        path, "w", driver="GTiff", width=SIDE_PX, height=SIDE_PX, count=3, dtype="uint8", crs="EPSG:32633", nodata=0,
        transform=rasterio.Affine(0.6, 0, 400_000, 0, -0.6, 5_300_000), compress="DEFLATE", zlevel=1, tiled=True,
        blockxsize=CHUNK_PX, blockysize=CHUNK_PX, photometric="RGB",
    ) as file:  # fmt: skip
        chunks = range(0, SIDE_PX, CHUNK_PX)
        for number, (row, col) in enumerate((row, col) for row in chunks for col in chunks):
            height, width = min(CHUNK_PX, SIDE_PX - row), min(CHUNK_PX, SIDE_PX - col)
            there = number % SHARE == 0
            values = np.roll(tile, number, axis=2)[:, :height, :width] if there else np.zeros((3, height, width), "u1")
            file.write(values, window=Window(col, row, width, height))
            mapped += height * width * there
    return mapped


def _picture(height: int, width: int) -> NDArray[np.float32]:
    """Lumps of green on gray with some noise, (3, row, col) of 0-255."""
    rng = np.random.default_rng(0)
    lumps = rng.normal(size=(height // 16 + 1, width // 16 + 1)).repeat(16, axis=0).repeat(16, axis=1)[:height, :width]
    base = np.stack([110 - 30 * lumps, 118 - 5 * lumps, 105 - 25 * lumps]) + rng.normal(0, 8, (3, height, width))
    return np.clip(base, 1, 255).astype(np.float32)


def _info(multiple_px: int, halo_px: int, preset: str = "small") -> CoverageModelInfo:
    return CoverageModelInfo(
        classes=CLASSES, resolution_m=0.6, multiple_px=multiple_px, halo_px=halo_px, channel_mean=(127.5,) * 3,
        channel_scale=(127.5,) * 3, thresholds=(0.5, 0.5), preset=preset, program_version="0",
    )  # fmt: skip


def _exported(network: object, info: CoverageModelInfo) -> bytes:
    from urbanforest_cli.imagery.learning.onnx_export import export_onnx

    return export_onnx(network, info)  # type: ignore[arg-type]


def _quantised(content: bytes, info: CoverageModelInfo) -> bytes:
    """Return the model in int8: weights by channel, activations by what a few pictures give."""
    import onnx
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

    mean, scale = (np.array(values, np.float32)[:, None, None] for values in (info.channel_mean, info.channel_scale))
    shown = iter([{INPUT_NAME: ((np.roll(_picture(256, 256), 40 * i, axis=1) - mean) / scale)[None]} for i in range(8)])

    class Pictures(CalibrationDataReader):  # type: ignore[misc]
        def get_next(self) -> dict[str, NDArray[np.float32]] | None:
            return next(shown, None)

    with tempfile.TemporaryDirectory() as name:
        source, target = Path(name, "model.onnx"), Path(name, "int8.onnx")
        source.write_bytes(content)
        logging.disable(logging.WARNING)  # it would advise a step that folds what is folded already
        quantize_static(source, target, Pictures(), quant_format=QuantFormat.QDQ, per_channel=True,
                        activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8)  # fmt: skip
        logging.disable(logging.NOTSET)
        model = onnx.load(target)
    del model.metadata_props[:]
    return sealed(model.SerializeToString(), replace(info).as_metadata())


def _medians(works: dict[str, Callable[[], object]], runs: int = RUNS) -> dict[str, float]:
    """Return the median CPU seconds of each, run in turn so that all meet the same machine."""
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for run in range(runs + 1):
        for name, work in works.items():
            started = time.process_time()
            work()
            if run:  # the first only warms up
                seconds[name].append(time.process_time() - started)
    return {name: statistics.median(values) for name, values in seconds.items()}


if __name__ == "__main__":
    main()
