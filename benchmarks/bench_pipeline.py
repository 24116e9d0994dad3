"""100,000 synthetic lots from city file to register and GeoJSON: CPU seconds and peak memory, a stage a line."""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from pathlib import Path

LOTS = int(os.environ.get("BENCH_LOTS", "100000"))


def main() -> None:
    from urbanforest_cli.core.progress import silent
    from urbanforest_cli.files.configs import load_config
    from urbanforest_cli.pipeline import Request, populate
    from urbanforest_cli.synth.stage import make_city

    with tempfile.TemporaryDirectory() as folder:
        city = Path(folder) / "city.gpkg"
        _warm(Path(folder))
        started = time.process_time()
        make_city(city, lot_count=LOTS, seed=1)
        print(f"synth {LOTS:,} lots: {time.process_time() - started:.1f} CPU s", flush=True)
        config = load_config().config
        total = 0.0
        for until in ("stencil", "diffuse", "place", "export"):
            started = time.process_time()
            request = Request(city=city, out=Path(folder) / "out", config=config, seed=1, until=until)
            summaries = populate(request, progress=silent)
            spent = time.process_time() - started
            total += spent
            counts = ", ".join(f"{value:,} {name}" for name, value in summaries[-1].counts.items() if value)
            print(f"{until:<8} {spent:6.1f} CPU s  {counts}", flush=True)
        sizes = {path.name: path.stat().st_size / 1e6 for path in (Path(folder) / "out").iterdir()}
        print(f"in all   {total:6.1f} CPU s, {', '.join(f'{name} {mb:.1f} MB' for name, mb in sizes.items())}")
        scale = 1024 if sys.platform != "darwin" else 1
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale / 1e9
        print(f"peak memory of this process, making the city included: {peak:.2f} GB")


def _warm(folder: Path) -> None:
    """Compile or load all kernels on a small city, so that the figures are those of every later run."""
    from urbanforest_cli.files.configs import load_config
    from urbanforest_cli.pipeline import Request, populate
    from urbanforest_cli.synth.stage import make_city

    make_city(folder / "warm.gpkg", lot_count=50, seed=2)
    populate(Request(city=folder / "warm.gpkg", out=folder / "warm", config=load_config().config, seed=1))


if __name__ == "__main__":
    main()
