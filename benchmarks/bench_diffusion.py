"""Measure context diffusion: CPU seconds and memory for a million lots, 16 parameters, a reach of 300 m.

Run as ``python -m benchmarks.bench_diffusion [--lots 1000000] [--reach 300]``.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from urbanforest_cli.context.diffusion import diffuse
from urbanforest_cli.core.params import PARAMETERS, STRATEGIES

LAND_PER_LOT_M2 = 600.0


def main() -> None:
    """Run the measurement and print one line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lots", type=int, default=1_000_000)
    parser.add_argument("--reach", type=float, default=300.0)
    arguments = parser.parse_args()
    n = arguments.lots
    rng = np.random.default_rng(1)
    side = np.sqrt(n * LAND_PER_LOT_M2)
    centres = rng.uniform(0, side, (n, 2)) + np.array([4e5, 5e6])
    values = {p.name: rng.uniform(p.low, p.high, n) for p in PARAMETERS.values()}
    values["context_radius_m"][:] = arguments.reach
    strategies = np.array(STRATEGIES, dtype=object)[rng.integers(0, len(STRATEGIES), n)]
    lot_ids = np.arange(n).astype(str).astype(object)
    small = np.arange(min(n, 100))
    diffuse(centres[small], {k: v[small] for k, v in values.items()},
            lot_ids=lot_ids[small], strategies=strategies[small], seed=1)  # fmt: skip
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    result = diffuse(centres, values, lot_ids=lot_ids, strategies=strategies, seed=1)
    seconds = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(
        f"diffusion of {n:,} lots, reach {arguments.reach:g} m, {len(values)} parameters: {seconds:.2f} CPU s, "
        f"{n / seconds:,.0f} lots/s, {result.lot_count.mean():.0f} lots heard, "
        f"peak {peak / 1024:.0f} MB ({(peak - before) / 1024:.0f} MB of it here)"
    )


if __name__ == "__main__":
    main()
