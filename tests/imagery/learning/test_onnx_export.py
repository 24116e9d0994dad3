"""Export: one file, the same numbers as torch, and proof of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import onnxruntime
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from urbanforest_cli.core.coverage_model import CoverageModelInfo  # noqa: E402
from urbanforest_cli.core.errors import OutputError  # noqa: E402
from urbanforest_cli.core.onnx_bytes import foreign_parts, sealed_metadata  # noqa: E402
from urbanforest_cli.imagery.learning import onnx_export  # noqa: E402
from urbanforest_cli.imagery.learning.network import (  # noqa: E402
    Generator,
    NetworkShape,
    build_generator,
    frozen,
    probabilities,
)
from urbanforest_cli.imagery.learning.onnx_export import PARITY_LIMIT, export_onnx  # noqa: E402

SMALL = NetworkShape(kind="small", class_count=2, filters=4, downs=3)
PIX2PIX = NetworkShape(kind="pix2pix", class_count=2, filters=2, downs=5)


def about(shape: NetworkShape) -> CoverageModelInfo:
    return CoverageModelInfo(
        classes=("canopy", "vegetation"), resolution_m=0.6, multiple_px=shape.multiple_px, halo_px=16,
        channel_mean=(120.0, 125.0, 110.0), channel_scale=(50.0, 45.0, 40.0), thresholds=(0.5, 0.4), preset=shape.kind,
        program_version="0", training={"minutes": 3},
    )  # fmt: skip


def used(shape: NetworkShape) -> Generator:
    network = build_generator(shape, seed=5)
    with torch.random.fork_rng():
        torch.manual_seed(6)
        for _ in range(5):
            network(torch.randn(2, 3, 64, 64) * 2.0 + 0.5)
    return network


@pytest.mark.parametrize("shape", [SMALL, PIX2PIX])
def test_the_file_gives_what_torch_gives_at_sizes_never_compared(shape: NetworkShape) -> None:
    network = used(shape)
    content = export_onnx(network, about(shape))
    assert network.training
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    for batch, rows, columns in ((1, 32, 160), (2, 96, 32), (5, 64, 64)):
        images = np.random.default_rng(rows).normal(size=(batch, 3, rows, columns)).astype(np.float32)
        found = session.run(["coverage"], {"image": images})[0]
        expected = probabilities(frozen(network, fold=False), images)
        assert found.dtype == np.float32
        assert np.abs(found - expected).max() < 1e-5
        assert float(np.ptp(expected)) > 0.01


@pytest.mark.parametrize("shape", [SMALL, PIX2PIX])
def test_the_file_is_sound_has_no_norms_and_opens_three_axes(shape: NetworkShape) -> None:
    content = export_onnx(used(shape), about(shape))
    model = onnx.load_from_string(content)
    onnx.checker.check_model(model, full_check=True)
    operators = {node.op_type for node in model.graph.node}
    activations = {"Relu", "LeakyRelu", "Sigmoid", "Tanh"}
    assert operators <= {"Conv", "ConvTranspose", "Concat", "Add", "Mul", "Clip", "Constant"} | activations
    assert [entry.version for entry in model.opset_import] == [17]
    for value, name, channels in ((model.graph.input[0], "image", 3), (model.graph.output[0], "coverage", 2)):
        dimensions = value.type.tensor_type.shape.dim
        assert value.name == name
        assert dimensions[1].dim_value == channels
        assert all(dimensions[axis].dim_param for axis in (0, 2, 3))
    assert foreign_parts(content) == []


def test_metadata_are_those_given_with_the_parity_found() -> None:
    content = export_onnx(used(SMALL), about(SMALL))
    stored = {entry.key: entry.value for entry in onnx.load_from_string(content).metadata_props}
    assert sealed_metadata(content) == {name: stored[name] for name in stored if name != "sha256"}
    info = CoverageModelInfo.from_metadata(stored)
    parity = info.training["parity_max"]
    assert 0.0 <= parity < 1e-5
    expected = dataclasses.replace(about(SMALL), training={"minutes": 3, "parity_max": parity, "opset": 17})
    assert info == expected


def test_the_same_network_gives_the_same_bytes_and_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    network = used(PIX2PIX)
    assert export_onnx(network, about(PIX2PIX)) == export_onnx(network, about(PIX2PIX))
    assert capfd.readouterr() == ("", "")


def test_three_sizes_are_compared_alone_and_as_three(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def watched(network: Generator, images: np.ndarray) -> np.ndarray:
        seen.append(images.shape)
        return probabilities(network, images)

    monkeypatch.setattr(onnx_export, "probabilities", watched)
    export_onnx(used(SMALL), about(SMALL))
    assert [shape[0] for shape in seen] == [1, 3] * 3
    assert len({shape[2:] for shape in seen}) == 3
    assert any(shape[2] % 16 for shape in seen) or any(shape[3] % 16 for shape in seen)


def test_a_difference_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnx_export, "probabilities", lambda *both: probabilities(*both) + np.float32(2 * PARITY_LIMIT))
    with pytest.raises(OutputError, match="no model was written"):
        export_onnx(used(SMALL), about(SMALL))


def test_weights_that_are_not_finite_are_refused() -> None:
    network = used(SMALL)
    with torch.no_grad():
        next(network.parameters())[0, 0, 0, 0] = float("nan")
    with pytest.raises(OutputError, match="differ by"):
        export_onnx(network, about(SMALL))


def test_metadata_that_cannot_be_are_refused() -> None:
    with pytest.raises(OutputError, match="classes"):
        export_onnx(used(SMALL), dataclasses.replace(about(SMALL), classes=("canopy",), thresholds=(0.5,)))
    with pytest.raises(ValueError, match="thresholds"):
        export_onnx(used(SMALL), dataclasses.replace(about(SMALL), thresholds=(0.5,)))


@pytest.mark.slow
def test_the_published_network_keeps_parity() -> None:
    shape = NetworkShape(kind="pix2pix", class_count=2)
    network = build_generator(shape, seed=1)
    network(torch.zeros(2, 3, 256, 256).normal_())
    content = export_onnx(network, about(shape))
    assert CoverageModelInfo.from_metadata(sealed_metadata(content)).training["parity_max"] < 1e-5


def test_a_pix2pix_network_that_is_sure_exports_too():
    """Where tanh is at its end in torch, it may lie beyond it by a digit elsewhere."""
    network = used(PIX2PIX)
    with torch.no_grad():
        list(network.parameters())[-2].zero_()
        list(network.parameters())[-1].fill_(8.611852)  # where onnxruntime's tanh is 1 + 2.4e-7
    graph = onnxruntime.InferenceSession(export_onnx(network, about(PIX2PIX)))
    found = graph.run(None, {"image": np.zeros((1, 3, 64, 64), dtype=np.float32)})[0]
    assert found.max() == 1.0
