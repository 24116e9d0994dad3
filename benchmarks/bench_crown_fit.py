"""Measure how fast crowns are fitted to covered ground; run `python -m benchmarks.bench_crown_fit [--lots 2000]`.

Lots have from 4 to 40 crowns at random places, a third of them closed canopy, in cells of 0.3 m. Times are CPU
seconds of one thread; kernels are compiled before the clock starts. The plain loop of the tests is the rival, and a
share of its discs that are the kernel's is printed, which must be all.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from tests.reference import crown_fit as reference
from urbanforest_cli.core.crown_fit_kernel import fit_kernel

CELL_M = 0.3
FEW = 20


def main() -> None:
    """Run the measurement and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lots", type=int, default=2000)
    count = parser.parse_args().lots
    lots = [lot(seed) for seed in range(count)]
    fit_kernel(*lots[0])
    found, seconds = run(fit_kernel, lots)
    crowns = sum(len(discs) for discs in found)
    cells = sum(arguments[0].size for arguments in lots)
    print(
        f"crowns fitted in {count:,} lots, {cells / count:,.0f} cells each: {seconds:.2f} CPU s, "
        f"{count / seconds:,.0f} lots/s, {crowns / seconds:,.0f} crowns/s, {cells / seconds / 1e6:.1f} M cells/s"
    )
    few = lots[:FEW]
    own, own_seconds = run(fit_kernel, few * 10)
    slow, slow_seconds = run(reference.fit, few)
    same = sum(len(a) == len(b) and np.allclose(a, b, atol=1e-6) for a, b in zip(own, slow, strict=False))
    print(
        f"plain loop, {FEW} lots: {slow_seconds:.2f} CPU s, {FEW / slow_seconds:,.1f} lots/s, "
        f"{slow_seconds / (own_seconds / 10):,.0f}x the kernel's time; same crowns in {same} of {FEW} lots"
    )


def run(fit, lots):  # type: ignore[no-untyped-def]
    """Return the discs of all lots and CPU seconds."""
    start = time.process_time()
    found = [fit(*arguments)[0] for arguments in lots]
    return found, time.process_time() - start


def lot(seed: int) -> tuple[np.ndarray, ...]:
    """Return what the kernel takes for one lot of 20 to 40 m."""
    rng = np.random.default_rng(seed)
    height, width = (rng.uniform(20, 40, 2) / CELL_M).astype(int)
    crowns = rng.integers(4, 40)
    x, y = rng.uniform(0, width, crowns), rng.uniform(0, height, crowns)
    radius = rng.normal(2.5, 0.5, crowns) / CELL_M
    rows, cols = np.mgrid[0:height, 0:width] + 0.5
    reach = np.full((height, width), -np.inf)
    for a, b, r in zip(x, y, radius, strict=True):
        reach = np.maximum(reach, r - np.hypot(cols - a, rows - b))
    if seed % 3 == 0:
        reach += 2.0 / CELL_M
    percent = np.clip(50 + 100 * reach, 0, 100).astype(np.uint8)
    law = 2.5 / CELL_M, 0.25 / CELL_M**2, 2.0, 0.5 / CELL_M, 0.25
    stems = np.ones((height, width), np.uint8)
    return percent, stems, *law, 1.0, np.uint64(seed), np.empty((0, 3))


if __name__ == "__main__":
    main()
