"""100,000 synthetic lots from city file to register and GeoJSON: CPU seconds and peak memory, a stage a line.

Twice: a city of lots, buildings and driveways, as most registers are, and one with all that `synth` makes (roads and
their street strips, doors and windows, hydrants, rails). Each stage runs in a process of its own, kernels loaded from
their cache, so that its figures are its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

LOTS = int(os.environ.get("BENCH_LOTS", "100000"))
PLAIN_LAYERS = ("lots", "buildings", "driveways")
STAGE = """
import json, resource, sys
from pathlib import Path
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.pipeline import Request, populate
city, out, until = sys.argv[1:]
request = Request(city=Path(city), out=Path(out), config=load_config().config, seed=1, until=until)
summary = populate(request)[-1]
usage = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps([usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, summary.counts]))
"""


def main() -> None:
    from urbanforest_cli.synth.stage import make_city

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_city(folder / "warm.gpkg", lot_count=200, seed=2)
        _run(folder / "warm.gpkg", folder / "warm", "export")
        whole = folder / "whole.gpkg"
        make_city(whole, lot_count=LOTS, seed=1)
        plain = folder / "plain.gpkg"
        _copy_layers(whole, plain)
        for city in (plain, whole):
            _measure(city, folder / f"{city.stem}-out")


def _measure(city: Path, out: Path) -> None:
    print(f"{city.stem} city, {LOTS:,} lots, {city.stat().st_size / 1e6:.0f} MB")
    spent, peak = 0.0, 0.0
    for until in ("stencil", "diffuse", "place", "export"):
        seconds, memory_mb, counts = _run(city, out, until)
        if until != "export":
            spent, peak = spent + seconds, max(peak, memory_mb)
        shown = ", ".join(f"{value:,} {key.replace('_', ' ')}" for key, value in counts.items() if value)
        print(f"  {until:<8} {seconds:6.1f} CPU s  {memory_mb:6.0f} MB  {shown[:110]}", flush=True)
    geojson = _geojson_seconds(out)
    print(
        f"  city file to register: {spent:.1f} CPU s, peak {peak:.0f} MB; plants.geojson alone {geojson:.1f} CPU s more"
    )
    print(f"  to register and GeoJSON: {spent + geojson:.1f} CPU s")


def _run(city: Path, out: Path, until: str) -> tuple[float, float, dict[str, int | float | str]]:
    arguments = [sys.executable, "-c", STAGE, str(city), str(out), until]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    seconds, memory_mb, counts = json.loads(done.stdout)
    return seconds, memory_mb, counts


def _copy_layers(source: Path, target: Path) -> None:
    import pyogrio

    from urbanforest_cli.files.geopackage import write_layers

    kinds = dict(pyogrio.list_layers(source))
    frames = {name: pyogrio.read_dataframe(source, layer=name, use_arrow=True) for name in PLAIN_LAYERS}
    write_layers(target, frames, fresh=True, geometry_types={name: kinds[name] for name in frames})


def _geojson_seconds(out: Path) -> float:
    import time

    import shapely

    from urbanforest_cli.files.geojson import write_points
    from urbanforest_cli.files.geopackage import read_layer

    plants = read_layer(out / "register.gpkg", "plants").to_crs(4326)
    degrees = shapely.get_coordinates(plants.geometry.to_numpy())
    started = time.process_time()
    write_points(out / "again.geojson", degrees, plants.drop(columns="geometry"))
    return time.process_time() - started


if __name__ == "__main__":
    main()
