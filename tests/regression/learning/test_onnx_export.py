"""Export: one file, the same numbers as torch, and proof of it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.regression.learning.pairs import squares

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from urbanforest_cli.core.errors import OutputError  # noqa: E402
from urbanforest_cli.core.onnx_bytes import foreign_parts, sealed_metadata  # noqa: E402
from urbanforest_cli.core.parameter_input import network_input  # noqa: E402
from urbanforest_cli.core.parameter_metadata import PARAMETER_OPERATORS, from_metadata  # noqa: E402
from urbanforest_cli.core.parameter_model import ParameterModelInfo  # noqa: E402
from urbanforest_cli.core.schema import REGRESSED  # noqa: E402
from urbanforest_cli.files.parameter_models import ParameterSession  # noqa: E402
from urbanforest_cli.regression.features import FEATURES  # noqa: E402
from urbanforest_cli.regression.learning import onnx_export  # noqa: E402
from urbanforest_cli.regression.learning.network import frozen, readings  # noqa: E402
from urbanforest_cli.regression.learning.onnx_export import PARITY_LIMIT, export_onnx  # noqa: E402
from urbanforest_cli.regression.learning.samples import HIGH, LOW  # noqa: E402
from urbanforest_cli.regression.learning.settings import INFORMED, PAPER  # noqa: E402
from urbanforest_cli.regression.learning.training import build_network  # noqa: E402


def about(settings):
    features = FEATURES if settings.network == "informed" else ()
    return ParameterModelInfo(settings.network, REGRESSED, LOW, HIGH, features, 64, {"a": 1}, {})


def built(settings, pairs):
    torch.manual_seed(3)
    return build_network(settings, pairs.features)


@pytest.mark.parametrize("settings", [INFORMED, PAPER])
def test_the_file_gives_in_units_what_torch_gives_in_shares(settings):
    pairs = squares(50)
    network = built(settings, pairs)
    content = export_onnx(network, about(settings), pairs)
    assert network.training
    fresh = squares(7, seed=2)
    shares = readings(frozen(network), network_input(fresh.windows, fresh.pixel_m), fresh.features)
    found = ParameterSession(content, about(settings)).predict(fresh.windows, fresh.pixel_m, fresh.features)
    low, width = np.array(LOW), np.array(HIGH) - np.array(LOW)
    for one, other in zip(found, (low + width * shares[0], width * shares[1], shares[2]), strict=True):
        assert one == pytest.approx(other, abs=1e-4)
    assert np.ptp(found[0][:, 0]) > 1e-4


@pytest.mark.parametrize("settings", [INFORMED, PAPER])
def test_the_file_is_sound_small_and_asks_for_nothing_foreign(settings):
    pairs = squares(50)
    content = export_onnx(built(settings, pairs), about(settings), pairs)
    onnx.checker.check_model(onnx.load_from_string(content), full_check=True)
    assert foreign_parts(content, PARAMETER_OPERATORS) == []
    assert len(content) < 5_000_000
    info = from_metadata(sealed_metadata(content))
    assert info.training["a"] == 1
    assert 0.0 <= info.training["parity_max"] <= PARITY_LIMIT
    assert info.parameters == REGRESSED


def test_a_difference_is_refused(monkeypatch):
    pairs = squares(50)

    def off(*given):
        value, *rest = readings(*given)
        return value + np.float32(2 * PARITY_LIMIT), *rest

    monkeypatch.setattr(onnx_export, "readings", off)
    with pytest.raises(OutputError, match="no model was written"):
        export_onnx(built(PAPER, pairs), about(PAPER), pairs)
    monkeypatch.setattr(onnx_export, "readings", lambda *given: [np.nan * part for part in readings(*given)])
    with pytest.raises(OutputError, match="inf"):
        export_onnx(built(PAPER, pairs), about(PAPER), pairs)
