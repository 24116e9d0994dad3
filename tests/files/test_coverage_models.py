"""Coverage models on disk: a good one is read, and whatever is wrong with another is told."""

from __future__ import annotations

import hashlib
import itertools
import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")

from urbanforest_cli.core.coverage_model import CoverageModelInfo  # noqa: E402
from urbanforest_cli.core.errors import InputError, LimitError, OutputError  # noqa: E402
from urbanforest_cli.core.onnx_bytes import sealed  # noqa: E402
from urbanforest_cli.files import coverage_models  # noqa: E402
from urbanforest_cli.files.coverage_models import load_coverage_model, write_coverage_model  # noqa: E402

OPEN = ["batch", 3, "rows", "columns"]
FLOAT = onnx.TensorProto.FLOAT


def about(**changes: Any) -> CoverageModelInfo:
    values: dict[str, Any] = {
        "classes": ("canopy", "vegetation"), "resolution_m": 0.6, "multiple_px": 16, "halo_px": 8,
        "channel_mean": (120.0, 120.0, 120.0), "channel_scale": (50.0, 50.0, 50.0), "thresholds": (0.5, 0.5),
        "preset": "small", "program_version": "0",
    }  # fmt: skip
    return CoverageModelInfo(**(values | changes))


def node(operator: str, takes: list[str], gives: str, **attributes: Any) -> Any:
    return onnx.helper.make_node(operator, takes, [gives], **attributes)


def graph_of(
    nodes: list[Any],
    weights: dict[str, np.ndarray],
    *,
    takes: tuple[str, int, list[Any]] = ("image", FLOAT, OPEN),
    gives: tuple[str, int, list[Any]] = ("coverage", FLOAT, ["batch", 2, "rows", "columns"]),
) -> Any:
    graph = onnx.helper.make_graph(
        nodes, "graph", [onnx.helper.make_tensor_value_info(*takes)], [onnx.helper.make_tensor_value_info(*gives)],
        [onnx.numpy_helper.from_array(value, name) for name, value in weights.items()],
    )  # fmt: skip
    return onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)


def weight(factor: float = 0.1) -> np.ndarray:
    return np.full((2, 3, 3, 3), factor, dtype=np.float32)


def convolution(**changes: Any) -> list[Any]:
    return [node("Conv", ["image", "weight"], "raw", **({"pads": [1, 1, 1, 1]} | changes))]


def good(**parts: Any) -> Any:
    nodes = [*convolution(), node("Sigmoid", ["raw"], "coverage")]
    return graph_of(nodes, {"weight": weight()}, **parts)


def stored(folder: Path, model: Any, **changes: Any) -> Path:
    """Write a model with metadata and a seal that holds."""
    path = folder / "model.onnx"
    path.write_bytes(sealed(model.SerializeToString(), about(**changes).as_metadata()))
    return path


def refusal(path: Path) -> str:
    """Return what is said of a model that is not read."""
    with pytest.raises(InputError) as caught:
        load_coverage_model(path)
    assert caught.value.where == path
    assert caught.value.next_step is not None
    return f"{caught.value.what}: {caught.value.found}"


def test_a_good_model_is_read_and_nothing_is_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = stored(tmp_path, good())
    model = load_coverage_model(path)
    assert model.info == about()
    assert model.content == path.read_bytes()
    assert model.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert model.path == path
    assert capfd.readouterr() == ("", "")


def test_a_model_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = stored(tmp_path, good()).read_bytes()
    path = tmp_path / "new" / "model.onnx"
    write_coverage_model(path, content)
    assert path.read_bytes() == content
    with pytest.raises(ValueError, match="checksum"):
        write_coverage_model(path, good().SerializeToString())
    monkeypatch.setattr(Path, "write_bytes", lambda path, content: path.open("wb").close())
    with pytest.raises(OutputError, match="not written whole"):
        write_coverage_model(path, content + b"")
    assert path.read_bytes() == content
    assert [file.name for file in path.parent.iterdir()] == ["model.onnx"]


def test_flipped_bits_are_all_seen(tmp_path: Path) -> None:
    path = stored(tmp_path, good())
    content = path.read_bytes()
    for place in np.random.default_rng(1).integers(0, 8 * len(content), 200).tolist():
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        assert refusal(path)


def test_files_cut_short_or_with_a_tail_are_seen(tmp_path: Path) -> None:
    path = stored(tmp_path, good())
    content = path.read_bytes()
    for length in np.random.default_rng(2).integers(0, len(content), 100).tolist():
        path.write_bytes(content[:length])
        assert refusal(path)
    for tail in (b"\x00", b"\x08\x08", content):
        path.write_bytes(content + tail)
        assert refusal(path)


class Trap:
    """Leaves a file behind where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.path,)


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    path, trace = tmp_path / "model.onnx", tmp_path / "trace"
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        path.write_bytes(pickle.dumps(Trap(trace), protocol=protocol))
        assert refusal(path)
    assert "such files can run code" in refusal(path)
    with path.open("wb") as stream:
        np.savez(stream, weights=np.zeros(3))
    assert "archive" in refusal(path)
    assert not trace.exists()


def test_what_is_no_readable_file_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = time.monotonic()
    pipe, loop, empty = tmp_path / "pipe", tmp_path / "loop", tmp_path / "empty.onnx"
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    empty.touch()
    assert "a pipe" in refusal(pipe)
    assert "device" in refusal(Path("/dev/zero"))
    assert "symbolic links" in refusal(loop)
    assert "an empty file" in refusal(empty)
    assert "a folder" in refusal(tmp_path)
    assert "No such file" in refusal(tmp_path / "none.onnx")
    for remote in ("/vsicurl/http://example.org/model.onnx", "https://example.org/model.onnx"):
        with pytest.raises(InputError, match="only local files"):
            load_coverage_model(Path(remote))
    assert time.monotonic() - started < 60  # a pipe without a writer would wait for ever
    monkeypatch.setattr(coverage_models, "MOST_BYTES", 100)
    with pytest.raises(LimitError, match="at most 100 bytes"):
        load_coverage_model(stored(tmp_path, good()))


def test_a_text_or_a_foreign_model_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    path.write_text("a page of text, as a failed download leaves it\n" * 20)
    assert "no ONNX model" in refusal(path)
    path.write_bytes(good().SerializeToString())
    assert "does not hold its checksum" in refusal(path)
    path.write_bytes(sealed(good().SerializeToString(), {"format": "another"}))
    assert "format" in refusal(path)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('"thresholds": [0.5, 0.5]', '"thresholds": [0.5]', "thresholds"),
        ('"multiple_px": 16', '"multiple_px": Infinity', "infinity"),
        ('"multiple_px": 16', '"multiple_px": 100000', "multiple_px"),
        ('"resolution_m": 0.6', '"resolution_m": NaN', "finite"),
        ('"vegetation"', '"canopy"', "distinct"),
        ('"preset": "small", ', "", "preset"),
        ("{", "[" * 50_000, "cannot be read"),
    ],
)
def test_metadata_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, reason: str) -> None:
    path = tmp_path / "model.onnx"
    metadata = about().as_metadata()
    assert old in metadata["model"]
    changed = metadata | {"model": metadata["model"].replace(old, new, 1)}
    path.write_bytes(sealed(good().SerializeToString(), changed))
    assert reason in refusal(path)


def external() -> Any:
    model = good()
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../../../../../etc/passwd")
    return model


def branching() -> Any:
    inner = onnx.helper.make_graph([], "inner", [], [onnx.helper.make_tensor_value_info("image", FLOAT, OPEN)])
    condition = node("Constant", [], "yes", value=onnx.numpy_helper.from_array(np.array(True)))
    choice = onnx.helper.make_node("If", ["yes"], ["coverage"], then_branch=inner, else_branch=inner)
    return graph_of([condition, choice], {})


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (external, "weights in another file"),
        (branching, "a graph inside a graph, operator If"),
        (lambda: graph_of([node("RandomUniformLike", ["image"], "coverage")], {}), "operator RandomUniformLike"),
        (lambda: graph_of([node("Gelu", ["image"], "coverage", domain="com.microsoft")], {}), "com.microsoft.Gelu"),
    ],
)
def test_what_a_model_may_not_ask_for_is_refused_before_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: Callable[[], Any], reason: str
) -> None:
    monkeypatch.setattr(coverage_models, "_probe", lambda *_: pytest.fail("it ran"))
    assert reason in refusal(stored(tmp_path, make()))


def ending(*nodes: Any, value: float = 0.1, end: str = "Sigmoid", **parts: Any) -> Any:
    """Return a model of these nodes up to `raw`, with a function at its end."""
    return graph_of([*nodes, node(end, ["raw"], "coverage")], {"weight": weight(value)}, **parts)


def doubled(times: int) -> Any:
    names = ["image", *(f"wide{i}" for i in range(times))]
    nodes = [node("Concat", [before, before], after, axis=1) for before, after in itertools.pairwise(names)]
    return graph_of([*nodes, *good().graph.node], {"weight": weight()})


def plain(kind: int, dimensions: list[Any]) -> Any:
    """Return a model that passes its input on, of this type and shape."""
    cast = node("Cast", ["image"], "coverage", to=FLOAT)
    return graph_of([cast], {}, takes=("image", kind, dimensions), gives=("coverage", FLOAT, dimensions))


MISBEHAVING: dict[str, tuple[Callable[[], Any], str]] = {
    "graph that does not hang together": (lambda: good(takes=("picture", FLOAT, OPEN)), "image"),
    "node without input": (lambda: ending(node("Relu", ["nowhere"], "raw")), "nowhere"),
    "other input": (
        lambda: ending(node("Conv", ["rgb", "weight"], "raw"), takes=("rgb", FLOAT, OPEN)),
        "rgb, not image",
    ),
    "other output": (lambda: good(gives=("raw", FLOAT, ["batch", 2, "rows", "columns"])), "raw, not coverage"),
    "integers": (lambda: plain(onnx.TensorProto.INT64, OPEN), "tensor(int64)"),
    "two dimensions": (lambda: plain(FLOAT, ["batch", 3]), "of four dimensions"),
    "one channel": (lambda: plain(FLOAT, ["batch", 1, "rows", "columns"]), "'batch', 1, 'rows'"),
    "one size": (lambda: good(takes=("image", FLOAT, [1, 3, 80, 96])), "of any batch, rows and columns"),
    "another number of classes": (lambda: plain(FLOAT, OPEN), "the shape (2, 3, 80, 96), not (2, 2, 80, 96)"),
    "half the size": (lambda: ending(*convolution(strides=[2, 2])), "the shape (2, 2, 40, 48)"),
    "above one": (lambda: ending(*convolution(), value=9.0, end="Relu"), "not 0 and 1"),
    "below zero": (lambda: ending(*convolution(), end="Tanh"), "not 0 and 1"),
    "not a number": (lambda: ending(*convolution(), value=np.nan), "not finite"),
    "memory by channels": (lambda: doubled(40), "far more memory"),
    "memory by channels, just more than a window of it would bear": (lambda: doubled(13), "far more memory"),
    "memory by margins": (lambda: ending(*convolution(pads=[10**6] * 4)), "far more memory"),
}


@pytest.mark.parametrize("name", MISBEHAVING)
def test_what_a_model_does_on_a_small_image_is_looked_at(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str
) -> None:
    make, reason = MISBEHAVING[name]
    said = refusal(stored(tmp_path, make()))
    assert reason in said
    assert "Traceback" not in said
    assert ".cc" not in said
    assert capfd.readouterr() == ("", "")


def halved_and_doubled(levels: int) -> Any:
    """Keeps the size of images whose sides are multiples of 2^levels."""
    nodes, name = [], "image"
    for level in range(levels):
        nodes.append(node("AveragePool", [name], f"down{level}", kernel_shape=[2, 2], strides=[2, 2]))
        name = f"down{level}"
    for level in range(levels):
        nodes.append(node("ConvTranspose", [name, "grow"], f"up{level}", strides=[2, 2]))
        name = f"up{level}"
    nodes += [node("Add", ["image", name], "both"), node("Conv", ["both", "weight"], "raw", pads=[1] * 4)]
    grow = np.full((3, 3, 2, 2), 0.1, dtype=np.float32)
    return graph_of([*nodes, node("Sigmoid", ["raw"], "coverage")], {"grow": grow, "weight": weight()})


def test_sizes_that_are_said_to_go_must_go(tmp_path: Path) -> None:
    assert load_coverage_model(stored(tmp_path, halved_and_doubled(4), multiple_px=16))
    assert "failed" in refusal(stored(tmp_path, halved_and_doubled(5), multiple_px=16))


def test_a_model_that_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coverage_models, "PROBE_SECONDS", 1)
    names = ["image", *(f"slow{i}" for i in range(2000))]
    nodes = [
        node("MaxPool", [before], after, kernel_shape=[63, 63], pads=[31] * 4)
        for before, after in itertools.pairwise(names)
    ]
    slow = [*nodes, node("Conv", [names[-1], "weight"], "raw", pads=[1] * 4), node("Sigmoid", ["raw"], "coverage")]
    assert "takes more than 1 s" in refusal(stored(tmp_path, graph_of(slow, {"weight": weight()})))


def test_a_program_without_a_model_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coverage_models, "SHIPPED", tmp_path / "coverage.onnx")
    with pytest.raises(InputError, match="train-coverage"):
        load_coverage_model()
    write_coverage_model(tmp_path / "coverage.onnx", stored(tmp_path, good()).read_bytes())
    assert load_coverage_model().info == about()


def test_bad_models_of_others_are_refused(bad_inputs: Path) -> None:
    paths = sorted((bad_inputs / "onnx").iterdir())
    assert len(paths) >= 4
    for path in paths:
        assert refusal(path)
