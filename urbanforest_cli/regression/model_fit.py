"""Whether a parameter model and this version of the program speak of the same things."""

from __future__ import annotations

from pathlib import Path

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.parameter_model import ParameterModelInfo
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.features import FEATURES, NETWORK_PX


def refuse_other_version(info: ParameterModelInfo, path: Path) -> None:
    """Refuse a sound model whose parameters, features or windows are not those of this version.

    Raises
    ------
    InputError
        It tells other parameters than `REGRESSED`, asks for a feature that is not computed, or has windows of another
        size; says which.
    """
    unknown = [name for name in info.parameters if name not in REGRESSED]
    missing = [name for name in REGRESSED if name not in info.parameters]
    features = [name for name in info.features if name not in FEATURES]
    window = [] if info.window_px == NETWORK_PX else [f"{info.window_px} pixels"]
    differences = {
        "parameters not known here": unknown,
        "parameters that it does not tell": missing,
        "features not computed here": features,
        f"windows, which here have {NETWORK_PX} pixels": window,
    }
    found = [
        f"{what}: {', '.join(names[:3])}{', ...' * (len(names) > 3)}" for what, names in differences.items() if names
    ]
    if found:
        raise InputError(
            "this parameter model was made for another version of the program", where=path, found="; ".join(found),
            next_step="train it again with `urbanforest train-regression`, or leave it out for the one that comes with "
                      "the program",
        )  # fmt: skip
