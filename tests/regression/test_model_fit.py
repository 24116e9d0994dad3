"""Models of other versions of the program are told from those of this one."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.parameter_model import ParameterModelInfo
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.features import FEATURES, NETWORK_PX
from urbanforest_cli.regression.model_fit import refuse_other_version

INFO = ParameterModelInfo("informed", REGRESSED, (0.0,) * 6, (1.0,) * 6, FEATURES, NETWORK_PX)


@pytest.mark.parametrize(
    "changes",
    [{}, {"parameters": REGRESSED[::-1]}, {"features": FEATURES[5:2:-1]}, {"features": ()}],
)
def test_order_and_number_of_features_are_the_models_own(changes):
    refuse_other_version(replace(INFO, **changes), Path("m.onnx"))


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"parameters": ("radius_m", *REGRESSED[1:])}, f"not known here: radius_m; .* not tell: {REGRESSED[0]}$"),
        ({"parameters": REGRESSED[:5]}, f"not tell: {REGRESSED[5]}$"),
        ({"parameters": (*REGRESSED, "height_m")}, "not known here: height_m$"),
        ({"features": ("lot_size", *FEATURES[1:])}, "not computed here: lot_size$"),
        ({"features": ("a", "b", "c", "d")}, "not computed here: a, b, c, ...$"),
        ({"window_px": 32}, "have 64 pixels: 32 pixels$"),
    ],
)
def test_a_model_of_another_version_is_refused_and_what_differs_is_named(changes, found):
    with pytest.raises(InputError, match="another version") as caught:
        refuse_other_version(replace(INFO, **changes), Path("m.onnx"))
    assert caught.value.where == Path("m.onnx")
    assert re.search(found, caught.value.found)
