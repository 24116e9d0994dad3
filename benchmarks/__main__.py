"""Run every benchmark: `make bench`, or `python -m benchmarks NAME...` for some of them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path


def main() -> None:
    names = sorted(path.stem.removeprefix("bench_") for path in Path(__file__).parent.glob("bench_*.py"))
    wanted = sys.argv[1:] or names
    del sys.argv[1:]  # what follows is no concern of the single benchmarks
    for name in wanted:
        if name not in names:
            sys.exit(f"no benchmark {name!r}; there are {', '.join(names)}")
        print(f"\n== {name}", flush=True)
        importlib.import_module(f"benchmarks.bench_{name}").main()


if __name__ == "__main__":
    main()
