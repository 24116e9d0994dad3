"""Networks that turn an image into a coverage map: Pix2Pix as published, and a small U-Net for machines without GPU.

Pix2Pix after Isola, Zhu, Zhou and Efros (2017) with the options of its PyTorch release: `unet_256`, batch
normalisation, dropout 0.5, and a discriminator that judges patches of 70 x 70 pixels. Both generators keep the size
of the image, whose sides must be multiples of `NetworkShape.multiple_px`.
"""

from __future__ import annotations

import copy
import io
import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from urbanforest_cli.core.coverage_model import INPUT_NAME, OUTPUT_NAME

Kind = Literal["pix2pix", "small"]

OPSET = 17
INIT_STD = 0.02
LEAK = 0.2
DROPOUT = 0.5
WIDEST = 8
"""Channels grow to this many times those of the first level."""


@dataclass(frozen=True, kw_only=True)
class NetworkShape:
    """What of a generator is not in its weights."""

    kind: Kind
    class_count: int
    filters: int = 64
    downs: int = 8

    @property
    def multiple_px(self) -> int:
        """Sides of images must be multiples of this."""
        return 1 << self.downs

    def faults(self) -> list[str]:
        """Return a sentence for each value that cannot be."""
        lowest = 5 if self.kind == "pix2pix" else 1
        checks = {
            "kind must be pix2pix or small": self.kind in ("pix2pix", "small"),
            "class_count must lie within 1 and 16": 1 <= self.class_count <= 16,
            "filters must lie within 1 and 256": 1 <= self.filters <= 256,
            f"downs must lie within {lowest} and 10": lowest <= self.downs <= 10,
        }
        return [text for text, holds in checks.items() if not holds]


class Generator(nn.Module):
    """A network from images to coverage."""

    def probability(self, raw: Tensor) -> Tensor:
        """Turn what `forward` returned into probabilities from 0 to 1."""
        raise NotImplementedError


class UnetGenerator(Generator):
    """The generator of Pix2Pix; `forward` returns values from -1 to 1.

    Its dropout works in training alone. The release leaves it on in use, as the only noise, and there takes batch
    statistics from the image at hand; here a trained network is put to `eval()`, so that a pixel's value depends on
    its surroundings and on nothing else.
    """

    def __init__(
        self, in_channels: int, out_channels: int, filters: int = 64, downs: int = 8, dropout: bool = True
    ) -> None:
        super().__init__()
        wide = [filters * min(1 << level, WIDEST) for level in range(downs)]
        self.downs = nn.ModuleList([nn.Sequential(_halve(in_channels, wide[0]))])
        for level in range(1, downs):
            norm = [nn.BatchNorm2d(wide[level])] if level < downs - 1 else []  # the innermost map may be one pixel
            self.downs.append(nn.Sequential(nn.LeakyReLU(LEAK), _halve(wide[level - 1], wide[level]), *norm))
        self.ups = nn.ModuleList()
        for level in reversed(range(1, downs)):
            joined = wide[level] * (1 if level == downs - 1 else 2)
            drop = [nn.Dropout(DROPOUT)] if dropout and 4 <= level < downs - 1 else []
            self.ups.append(
                nn.Sequential(
                    nn.ReLU(), _double(joined, wide[level - 1]), nn.BatchNorm2d(wide[level - 1]), *drop
                )
            )  # fmt: skip
        self.last = nn.Sequential(nn.ReLU(), nn.ConvTranspose2d(2 * wide[0], out_channels, 4, 2, 1), nn.Tanh())
        initialise(self)

    def forward(self, image: Tensor) -> Tensor:
        """Map (batch, channel, row, col) to (batch, class, row, col) from -1 to 1."""
        levels = []
        for down in self.downs:
            image = down(image)
            levels.append(image)
        image = levels.pop()  # (batch, 8 filters, row / 2^downs, col / 2^downs)
        for up in self.ups:
            image = torch.cat([levels.pop(), up(image)], 1)
        result: Tensor = self.last(image)
        return result

    def probability(self, raw: Tensor) -> Tensor:
        """Bring -1 to 1 to 0 to 1; a runtime's tanh may reach beyond 1 by its last digit."""
        return ((raw + 1.0) * 0.5).clamp(0.0, 1.0)


class SmallUnet(Generator):
    """A light U-Net with a skip at every level, full resolution too; `forward` returns logits."""

    def __init__(self, class_count: int, filters: int = 16, downs: int = 5, in_channels: int = 3) -> None:
        super().__init__()
        wide = [filters] + [filters * min(1 << level, WIDEST) for level in range(1, downs + 1)]
        inward = range(downs)
        outward = range(downs - 1, -1, -1)
        self.stem = _normed(nn.Conv2d(in_channels, filters, 3, 1, 1, bias=False), filters)
        self.downs = nn.ModuleList(_normed(_halve(wide[i], wide[i + 1]), wide[i + 1]) for i in inward)
        self.ups = nn.ModuleList(_normed(_double(wide[i + 1], wide[i]), wide[i]) for i in outward)
        self.joins = nn.ModuleList(
            _normed(nn.Conv2d(2 * wide[i], wide[i], 3, 1, 1, bias=False), wide[i]) for i in outward
        )
        self.head = nn.Conv2d(filters, class_count, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Map (batch, 3, row, col) to logits (batch, class, row, col)."""
        image = self.stem(image)
        levels = []
        for down in self.downs:
            levels.append(image)
            image = down(image)
        for up, join in zip(self.ups, self.joins, strict=True):
            image = join(torch.cat([up(image), levels.pop()], 1))
        result: Tensor = self.head(image)
        return result

    def probability(self, raw: Tensor) -> Tensor:
        """Return the sigmoid of logits."""
        return torch.sigmoid(raw)


class PatchDiscriminator(nn.Module):
    """The 70 x 70 discriminator of Pix2Pix: a logit for each patch of image and map joined along their channels."""

    def __init__(self, in_channels: int, filters: int = 64) -> None:
        super().__init__()
        wide = [filters * factor for factor in (1, 2, 4, 8)]
        layers: list[nn.Module] = [nn.Conv2d(in_channels, wide[0], 4, 2, 1), nn.LeakyReLU(LEAK)]
        for before, after, stride in ((wide[0], wide[1], 2), (wide[1], wide[2], 2), (wide[2], wide[3], 1)):
            layers += [
                nn.Conv2d(before, after, 4, stride, 1, bias=False), nn.BatchNorm2d(after), nn.LeakyReLU(LEAK),
            ]  # fmt: skip
        self.layers = nn.Sequential(*layers, nn.Conv2d(wide[3], 1, 4, 1, 1))
        initialise(self)

    def forward(self, image_and_map: Tensor) -> Tensor:
        """Map (batch, channel, row, col) to logits (batch, 1, row / 8 - 2, col / 8 - 2)."""
        result: Tensor = self.layers(image_and_map)
        return result


def build_generator(shape: NetworkShape, *, seed: int | None = None) -> Generator:
    """Make a generator with new weights; with a `seed` they are the same each time, and torch's own state stays.

    Raises
    ------
    ValueError
        The shape cannot be; the text says why.
    """
    if faults := shape.faults():
        raise ValueError("; ".join(faults))
    with torch.random.fork_rng(devices=[], enabled=seed is not None):
        if seed is not None:
            torch.manual_seed(seed)
        if shape.kind == "pix2pix":
            return UnetGenerator(3, shape.class_count, shape.filters, shape.downs)
        return SmallUnet(shape.class_count, shape.filters, shape.downs)


def initialise(network: nn.Module) -> None:
    """Draw weights as Pix2Pix does: convolutions normal(0, 0.02), norms normal(1, 0.02), biases 0."""
    for module in network.modules():
        if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d, nn.BatchNorm2d)):
            nn.init.normal_(module.weight, 1.0 if isinstance(module, nn.BatchNorm2d) else 0.0, INIT_STD)
            if module.bias is not None:
                nn.init.zeros_(module.bias)


def parameter_count(network: nn.Module) -> int:
    """Return how many numbers are trained."""
    return sum(parameter.numel() for parameter in network.parameters())


def probabilities(network: Generator, images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Run a network as it is used: (batch, 3, row, col), normalised, to probabilities (batch, class, row, col).

    The network must be in `eval()` mode already, since switching it here would go unseen in a training.
    """
    device = next(network.parameters()).device
    with torch.inference_mode():
        result = network.probability(network(torch.from_numpy(images).to(device)))
    return np.asarray(result.float().cpu().numpy(), dtype=np.float32)


def frozen(network: Generator, *, fold: bool = True) -> Generator:
    """Return a copy for use: on the CPU, in float32, in `eval()` mode, and with norms folded into the convolutions."""
    copied = copy.deepcopy(network).to(device="cpu", dtype=torch.float32)
    copied.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    copied.eval()
    if fold:
        for chain in [module for module in copied.modules() if isinstance(module, nn.Sequential)]:
            _fold(chain)
    for parameter in copied.parameters():
        parameter.requires_grad_(False)
    return copied


def traced(network: Generator, *, side_px: int) -> bytes:
    """Return a frozen network as ONNX, with its probability inside and any batch, height and width.

    `side_px` is the side of the image it is followed with; the graph holds no trace of it.
    """
    axes = {0: "batch", 2: "rows", 3: "columns"}
    content = io.BytesIO()
    with warnings.catch_warnings(action="ignore"):  # this exporter, which needs no other package, calls itself old
        torch.onnx.export(
            _WithProbability(network).eval(),
            (torch.zeros(1, 3, side_px, side_px),),
            content,  # type: ignore[arg-type]
            dynamo=False,
            opset_version=OPSET,
            input_names=[INPUT_NAME],
            output_names=[OUTPUT_NAME],
            dynamic_axes={INPUT_NAME: axes, OUTPUT_NAME: axes},
        )
    return content.getvalue()


class _WithProbability(nn.Module):
    def __init__(self, network: Generator) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor) -> Tensor:
        return self.network.probability(self.network(image))


def _halve(before: int, after: int) -> nn.Conv2d:
    return nn.Conv2d(before, after, 4, 2, 1, bias=False)


def _double(before: int, after: int) -> nn.ConvTranspose2d:
    return nn.ConvTranspose2d(before, after, 4, 2, 1, bias=False)


def _normed(layer: nn.Module, channels: int) -> nn.Sequential:
    return nn.Sequential(layer, nn.BatchNorm2d(channels), nn.ReLU())


def _fold(chain: nn.Sequential) -> None:
    for index in range(len(chain) - 1, 0, -1):
        layer, norm = chain[index - 1], chain[index]
        if isinstance(norm, nn.BatchNorm2d) and isinstance(layer, (nn.Conv2d, nn.ConvTranspose2d)):
            chain[index - 1] = fuse_conv_bn_eval(layer, norm, transpose=isinstance(layer, nn.ConvTranspose2d))
            chain[index] = nn.Identity()
