"""Parameter models on disk: a good one is read, and whatever is wrong with another is told."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")

from urbanforest_cli.core.errors import InputError, LimitError  # noqa: E402
from urbanforest_cli.core.onnx_bytes import sealed  # noqa: E402
from urbanforest_cli.core.parameter_metadata import as_metadata, from_metadata  # noqa: E402
from urbanforest_cli.core.parameter_model import ParameterModelInfo  # noqa: E402
from urbanforest_cli.files import parameter_models  # noqa: E402
from urbanforest_cli.files.coverage_models import load_coverage_model  # noqa: E402
from urbanforest_cli.files.parameter_models import (  # noqa: E402
    ParameterSession,
    load_parameter_model,
    write_parameter_model,
)

FLOAT = onnx.TensorProto.FLOAT
INPUTS = {"window": ["lots", 4, 64, 64], "features": ["lots", 3]}
OUTPUTS = {"value": ["lots", 2], "spread": ["lots", 2], "strategy": ["lots", 3]}
ABOUT = ParameterModelInfo("informed", ("a", "b"), (1.0, 0.0), (11.0, 2.0), ("x", "y", "z"), 64)


def node(operator: str, takes: list[str], gives: str, **attributes: Any) -> Any:
    return onnx.helper.make_node(operator, takes, [gives], **attributes)


def graph_of(
    nodes: list[Any], weights: dict[str, np.ndarray], *, inputs: dict[str, list[Any]] = INPUTS, kind: int = FLOAT
) -> Any:
    values = [
        [onnx.helper.make_tensor_value_info(name, kind, shape) for name, shape in them.items()]
        for them in (inputs, OUTPUTS)
    ]
    stored = [onnx.numpy_helper.from_array(value, name) for name, value in weights.items()]
    graph = onnx.helper.make_graph(nodes, "graph", *values, stored)
    return onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)


def good(value: str = "Sigmoid", spread: str = "Sigmoid", strategy: str = "Softmax", **parts: Any) -> Any:
    """The mean coverage and the first features, and spreads and strategies of the features alone."""
    weights = {
        "two": np.eye(3, 2, dtype=np.float32),
        "four": np.array([[1, 0], [0, 0], [0, 0], [0, 1]], np.float32),
        "three": np.eye(3, dtype=np.float32),
    }
    nodes = [
        node("GlobalAveragePool", ["window"], "mean"),
        node("Flatten", ["mean"], "flat"),
        node("Gemm", ["flat", "four"], "seen"),
        node("Gemm", ["features", "two"], "told"),
        node("Add", ["seen", "told"], "both"),
        node(value, ["both"], "value"),
        node(spread, ["told"], "spread"),
        node("Gemm", ["features", "three"], "logits"),
        node(strategy, ["logits"], "strategy"),
    ]
    return graph_of(nodes, weights, **parts)


def stored(folder: Path, model: Any, info: ParameterModelInfo = ABOUT) -> Path:
    """Write a model with metadata and a seal that holds."""
    path = folder / "model.onnx"
    path.write_bytes(sealed(model.SerializeToString(), as_metadata(info)))
    return path


def refusal(path: Path) -> str:
    """Return what is said of a model that is not read."""
    with pytest.raises(InputError) as caught:
        load_parameter_model(path)
    assert caught.value.where == path
    assert "train-regression" in str(caught.value.next_step)
    return f"{caught.value.what}: {caught.value.found}"


def test_a_good_model_is_read_and_nothing_is_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = stored(tmp_path, good())
    model = load_parameter_model(path)
    assert model.info == ABOUT
    assert model.content == path.read_bytes()
    assert model.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert capfd.readouterr() == ("", "")


def test_values_come_in_units_and_windows_go_in_as_shares(tmp_path: Path) -> None:
    model = load_parameter_model(stored(tmp_path, good()))
    session = ParameterSession(model.content, model.info)
    windows = np.zeros((2, 3, 64, 64), np.uint8)
    windows[0, 0] = 50
    values, spreads, strategy = session.predict(windows, np.array([2.0, 1.0], np.float32), np.zeros((2, 3), np.float32))
    sigmoid = [1 / (1 + np.exp(-share)) for share in (0.5, 1.0, 0.0, 0.5)]  # coverage and scale of the two lots
    assert values == pytest.approx(
        np.array([[1 + 10 * sigmoid[0], 2 * sigmoid[1]], [1 + 10 * sigmoid[2], 2 * sigmoid[3]]])
    )
    assert spreads == pytest.approx(np.tile([5.0, 1.0], (2, 1)))
    assert strategy == pytest.approx(1 / 3)


def test_what_is_written_is_read_again_and_must_be_sealed(tmp_path: Path) -> None:
    content = stored(tmp_path, good()).read_bytes()
    path = tmp_path / "new" / "model.onnx"
    write_parameter_model(path, content)
    assert path.read_bytes() == content
    with pytest.raises(ValueError, match="checksum"):
        write_parameter_model(path, good().SerializeToString())
    assert path.read_bytes() == content


def test_flipped_bits_and_cut_files_are_all_seen(tmp_path: Path) -> None:
    path = stored(tmp_path, good())
    content = path.read_bytes()
    rng = np.random.default_rng(1)
    for place in rng.integers(0, 8 * len(content), 100).tolist():
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        assert refusal(path)
    for length in rng.integers(0, len(content), 50).tolist():
        path.write_bytes(content[:length])
        assert refusal(path)


def test_a_model_of_another_kind_is_refused(tmp_path: Path) -> None:
    from tests.reference.tiny_coverage import greenness, info_of

    path = tmp_path / "coverage.onnx"
    path.write_bytes(greenness(info_of()))
    assert "format = urbanforest-parameter-model" in refusal(path)
    with pytest.raises(InputError, match="format = urbanforest-coverage-model"):
        load_coverage_model(stored(tmp_path, good()))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04rubbish", b"\x80\x04N.", b"text"])
def test_what_is_no_model_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(content)
    assert refusal(path)
    assert refusal(tmp_path)


def test_a_model_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_models, "MOST_BYTES", 100)
    with pytest.raises(LimitError, match="too large"):
        load_parameter_model(stored(tmp_path, good()))


def test_foreign_operators_are_refused_before_they_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_models, "_probe", lambda *_: pytest.fail("it ran"))
    assert "operator Erf" in refusal(stored(tmp_path, good(value="Erf")))


@pytest.mark.parametrize(
    ("make", "info", "reason"),
    [
        (lambda: good(value="Relu"), ABOUT, "value lies within"),
        (lambda: good(spread="Exp"), ABOUT, "spread lies within"),
        (lambda: good(strategy="Sigmoid"), ABOUT, "strategy does not sum to 1"),
        (lambda: good(), replace(ABOUT, window_px=32), "window takes"),
        (lambda: good(), replace(ABOUT, features=("x",)), "features takes"),
        (lambda: good(), replace(ABOUT, features=()), "its inputs are"),
        (lambda: good(), replace(ABOUT, parameters=("a",), low=(0,), high=(1,)), "has the shape"),
        (lambda: good(inputs={**INPUTS, "window": [1, 4, 64, 64]}), ABOUT, "any number of lots"),
    ],
)
def test_what_a_model_does_on_a_few_windows_is_looked_at(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], make: Callable[[], Any], info: ParameterModelInfo, reason: str
) -> None:
    said = refusal(stored(tmp_path, make(), info))
    assert reason in said
    assert "Traceback" not in said
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"network": "other"}, "network must be"),
        ({"parameters": ("a", "a")}, "distinct names"),
        ({"high": (1.0, 2.0)}, "the low below the high"),
        ({"low": (float("nan"), 0.0)}, "finite"),
        ({"features": ("x", "x")}, "features must be"),
        ({"window_px": 4}, "window_px"),
    ],
)
def test_metadata_that_cannot_be_are_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        from_metadata(as_metadata(replace(ABOUT, **changes)))


def test_metadata_come_back_as_they_were() -> None:
    told = replace(ABOUT, training={"pairs": {"count": 3}}, scores={"r2": [0.5]})
    assert from_metadata(as_metadata(told)) == told
    with pytest.raises(ValueError, match="format version"):
        from_metadata({**as_metadata(told), "format_version": "9"})
    with pytest.raises(ValueError, match="cannot be read"):
        from_metadata({**as_metadata(told), "model": "{}"})


def test_a_program_without_a_model_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_models, "SHIPPED", tmp_path / "parameters.onnx")
    with pytest.raises(InputError, match="train-regression"):
        load_parameter_model()
    write_parameter_model(tmp_path / "parameters.onnx", stored(tmp_path, good()).read_bytes())
    assert load_parameter_model().info == ABOUT


def test_the_model_that_comes_with_the_program_reads_what_it_computes() -> None:
    from urbanforest_cli.core.schema import REGRESSED
    from urbanforest_cli.regression.features import FEATURES

    model = load_parameter_model()
    assert model.info == load_parameter_model(model.path).info  # and passes being tried out
    assert model.info.features == FEATURES
    assert model.info.parameters == REGRESSED
    assert model.info.training["complete"]
    assert len(model.content) < 5_000_000
