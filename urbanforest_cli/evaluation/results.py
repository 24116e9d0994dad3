"""What a comparison takes and what it finds."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.evaluation.counts import CountScores
from urbanforest_cli.evaluation.edges import EDGE_SHARES
from urbanforest_cli.evaluation.point_patterns import NEIGHBOUR_SHARES, RADII_M
from urbanforest_cli.evaluation.scores import Score
from urbanforest_cli.evaluation.two_sample import ClassifierTest, FlipTest

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

REAL, MODEL, RANDOM, EVEN, LATTICE = "real", "model", "random", "even", "lattice"


@dataclass(frozen=True)
class PlantsOfLots:
    """Positions (n, 2) in metres and the lot of each, an index; in any order."""

    xy: Floats
    lot: Ints

    def by_lot(self, lots: int) -> list[Floats]:
        """Return one array of positions a lot, each in the order given."""
        order = np.argsort(self.lot, kind="stable")
        return np.split(self.xy[order], np.cumsum(np.bincount(self.lot, minlength=lots))[:-1])


@dataclass(frozen=True)
class ChamferRow:
    """Mean over lots of the sum of squared distances per lot area, both ways."""

    name: str
    against: str
    there: float
    back: float
    plants: int

    @property
    def mean(self) -> float:
        """Mean of both directions."""
        return (self.there + self.back) / 2


@dataclass(frozen=True)
class Curves:
    """What the plot draws beside the numbers; positions are in metres, curves by name of the set."""

    real_counts: Ints
    model_counts: Ints
    neighbour: dict[str, Floats]
    pooled_l: dict[str, Floats]
    envelope: tuple[Floats, Floats]
    edge_m: dict[str, Floats]
    building_m: dict[str, Floats]
    guesses: Floats


@dataclass(frozen=True)
class Evaluation:
    """Everything that is found; a part is None where there was too little to compare."""

    counts: CountScores
    lots_compared: int
    lots_eligible: int
    lots_too_large: int
    plants_compared: int
    kept_of_real: float | None = None
    kept_of_model: float | None = None
    chamfer: list[ChamferRow] = field(default_factory=list)
    neighbour: FlipTest | None = None
    l_function: FlipTest | None = None
    edge: FlipTest | None = None
    building: FlipTest | None = None
    classifier: ClassifierTest | None = None
    score: Score | None = None
    curves: Curves | None = field(default=None, repr=False)

    def as_record(self) -> dict[str, object]:
        """Return plain values for JSON, without the curves."""
        record = asdict(self)
        del record["curves"]
        record["measured_at"] = {
            "neighbour_quantiles": NEIGHBOUR_SHARES.tolist(),
            "l_radii_m": RADII_M.tolist(),
            "edge_and_building_quantiles": EDGE_SHARES.tolist(),
        }
        for row, plain in zip(self.chamfer, record["chamfer"], strict=True):
            plain["mean"] = row.mean
        return record
