"""The training itself: losses, steps, norms settled for use, validation, and a state that goes on exactly.

What a step does follows from the settings, the data and the step's number; the generators of random numbers are
seeded afresh each epoch. So a training that goes on from the state after an epoch ends in the same weights, bit by
bit on a CPU with the same number of threads.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from urbanforest_cli.core.coverage_model import UNKNOWN
from urbanforest_cli.core.randomness import key_for
from urbanforest_cli.core.training import Machine
from urbanforest_cli.imagery.learning.augment import STREAM, Batch, CropSource
from urbanforest_cli.imagery.learning.network import NetworkShape, PatchDiscriminator, build_generator
from urbanforest_cli.imagery.learning.settings import TrainingSettings, rate_at
from urbanforest_cli.imagery.learning.tiles import Tile, fitted, normalised
from urbanforest_cli.imagery.learning.validation import Tally

BATCHES_AHEAD = 2
NORM_PIXELS = 2_000_000
NORM_BATCHES = 64
"""Statistics for use are taken over about so many pixels of training images, in no more batches than this."""
VALIDATION_PIXELS = 1 << 19
"""Of tiles run at once."""
ADAM_BETA2 = 0.999
CLAMP = 1e-6

Weights = dict[str, Tensor]


class Trainer:
    """A network in training. Use within `settled`."""

    def __init__(self, settings: TrainingSettings, class_count: int, source: CropSource, machine: Machine) -> None:
        self._settings, self._source, self._machine = settings, source, machine
        shape = NetworkShape(
            kind=settings.preset, class_count=class_count, filters=settings.filters, downs=settings.downs
        )
        self.network = self._placed(build_generator(shape, seed=key_for(settings.seed, STREAM, "weights") >> 1))
        self._optimiser = self._adam(self.network)
        self._judge: nn.Module | None = None
        self._judge_optimiser: torch.optim.Optimizer | None = None
        if settings.loss == "l1+gan":
            torch.manual_seed(key_for(settings.seed, STREAM, "judge") >> 1)
            self._judge = self._placed(PatchDiscriminator(3 + class_count))
            self._judge_optimiser = self._adam(self._judge)

    @property
    def steps_an_epoch(self) -> int:
        """Return how many steps an epoch has."""
        return self._source.steps_an_epoch

    @property
    def learning_rate(self) -> float:
        """Return the rate of the last step."""
        return float(self._optimiser.param_groups[0]["lr"])

    def run_epoch(self, epoch: int, on_step: Callable[[int], None]) -> dict[str, float]:
        """Train one epoch, counted from 0, and return the mean of each loss by its name."""
        torch.manual_seed(key_for(self._settings.seed, STREAM, f"epoch {epoch}") >> 1)
        self.network.train()
        steps = self.steps_an_epoch
        sums: dict[str, Tensor] = {}
        for step, batch in enumerate(_ahead(lambda number: self._source.batch(epoch, number), steps)):
            rate, momentum = rate_at(self._settings, epoch * steps + step, steps)
            for optimiser in (self._optimiser, self._judge_optimiser):
                for group in optimiser.param_groups if optimiser is not None else ():
                    group["lr"], group["betas"] = rate, (momentum, ADAM_BETA2)
            for name, value in self._step(batch).items():
                sums[name] = sums.get(name, torch.zeros_like(value)) + value
            on_step(step + 1)
        return {name: float(value) / steps for name, value in sums.items()}

    def settle_norms(self) -> None:
        """Replace the running statistics of all norms by those of the network as it is, over training images.

        The running means lag behind the weights, far after a short training. Takes true colours, as in use.
        """
        norms = [module for module in self.network.modules() if isinstance(module, nn.BatchNorm2d)]
        kept = [norm.momentum for norm in norms]
        self.network.eval()
        for norm in norms:
            norm.reset_running_stats()
            norm.momentum = None  # a plain mean over batches
            norm.train()
        size = max(2, self._settings.batch)
        count = min(max(1, NORM_PIXELS // (size * self._settings.crop_px**2)), NORM_BATCHES)
        with torch.no_grad(), self._autocast():
            for batch in _ahead(lambda number: self._source.plain_batch(number, size), count):
                self.network(self._image(batch.images))
        for norm, momentum in zip(norms, kept, strict=True):
            norm.momentum = momentum
        self.network.eval()

    def probabilities(self, tiles: Sequence[Tile], *, exact: bool) -> Iterator[tuple[Tile, NDArray[np.float32]]]:
        """Run the network as it is used, statistics and all fixed; yield tiles as fitted and what it says of them.

        `exact` runs in float32, as the exported network does.
        """
        self.network.eval()
        for part in _alike(fitted(tile, self._settings.multiple_px) for tile in tiles):
            images = self._image(normalised(np.stack([tile.rgb for tile in part])))
            with torch.inference_mode(), contextlib.nullcontext() if exact else self._autocast():
                result = self.network.probability(self.network(images).float())
            yield from zip(part, result.cpu().numpy(), strict=True)

    def validate(self, tiles: Sequence[Tile], *, exact: bool = False) -> Tally:
        """Count how the network agrees with the truth of tiles."""
        tally = Tally(len(tiles[0].truth))
        for tile, probability in self.probabilities(tiles, exact=exact):
            tally.add(probability, tile.truth)
        return tally

    def weights(self) -> Weights:
        """Return a copy of the network's weights and statistics, on the CPU."""
        return {name: value.detach().cpu().clone() for name, value in self.network.state_dict().items()}

    def take_weights(self, weights: Weights) -> None:
        """Give the network weights that `weights` returned."""
        self.network.load_state_dict(weights)

    def state(self) -> dict[str, Any]:
        """Return all that the next epoch starts from, as tensors and plain values."""
        return {name: part.state_dict() for name, part in self._parts().items()}

    def take_state(self, state: dict[str, Any]) -> None:
        """Go on from what `state` returned."""
        for name, part in self._parts().items():
            part.load_state_dict(state[name])

    def _parts(self) -> dict[str, Any]:
        parts = {"network": self.network, "optimiser": self._optimiser}
        if self._judge is not None:
            parts |= {"judge": self._judge, "judge_optimiser": self._judge_optimiser}
        return parts

    def _placed(self, network: Any) -> Any:
        return network.to(device=self._machine.device, memory_format=torch.channels_last)

    def _adam(self, network: nn.Module) -> torch.optim.Optimizer:
        decay, rate = self._settings.weight_decay, self._settings.learning_rate
        kind = torch.optim.AdamW if decay > 0 else torch.optim.Adam
        return kind(network.parameters(), rate, (self._settings.momentum, ADAM_BETA2), weight_decay=decay, fused=True)

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self._machine.device, torch.bfloat16, enabled=self._machine.bf16)

    def _image(self, images: NDArray[np.float32]) -> Tensor:
        tensor = torch.from_numpy(images).to(self._machine.device, non_blocking=True)
        return tensor.contiguous(memory_format=torch.channels_last)

    def _step(self, batch: Batch) -> dict[str, Tensor]:
        image = self._image(batch.images)
        truth = torch.from_numpy(batch.truths).to(self._machine.device)
        known = truth != UNKNOWN
        share = torch.where(known, truth.float() / 100.0, 0.0)
        with self._autocast():
            raw = self.network(image).float()
        losses: dict[str, Tensor] = {}
        if self._settings.loss == "bce":
            losses["bce"] = total = _mean(_cross_entropy(self._settings, raw, share), known)
        else:
            probability = self.network.probability(raw)
            losses["l1"] = _mean(2.0 * (probability - share).abs(), known)
            total = losses["l1"] * self._settings.l1_weight
            if self._judge is not None and self._judge_optimiser is not None:
                drawn = torch.where(known, 2.0 * probability - 1.0, 0.0)
                real = torch.where(known, 2.0 * share - 1.0, 0.0)
                losses["judge"] = self._judge_step(self._judge, self._judge_optimiser, image, real, drawn.detach())
                losses["gan"] = self._says(self._judge, image, drawn, True)
                total = total + losses["gan"]
                self._judge.requires_grad_(True)
        self._optimiser.zero_grad()
        total.backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()
        return {name: value.detach() for name, value in losses.items()}

    def _judge_step(
        self, judge: nn.Module, optimiser: torch.optim.Optimizer, image: Tensor, real: Tensor, drawn: Tensor
    ) -> Tensor:
        """Teach the discriminator first, by half its loss on each of real and drawn; leave it without gradients."""
        loss = 0.5 * (self._says(judge, image, drawn, False) + self._says(judge, image, real, True))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        judge.requires_grad_(False)
        return loss.detach()

    def _says(self, judge: nn.Module, image: Tensor, coverage: Tensor, real: bool) -> Tensor:
        """Return the cross entropy of the discriminator's logits with what it should say."""
        with self._autocast():
            logits = judge(torch.cat([image, coverage], 1)).float()
        return functional.binary_cross_entropy_with_logits(logits, torch.full_like(logits, float(real)))


def _cross_entropy(settings: TrainingSettings, raw: Tensor, share: Tensor) -> Tensor:
    if settings.preset == "pix2pix":  # its raw values are no logits, but a hyperbolic tangent
        raw = 2.0 * torch.atanh(raw.clamp(CLAMP - 1.0, 1.0 - CLAMP))
    return functional.binary_cross_entropy_with_logits(raw, share, reduction="none")


def _mean(values: Tensor, known: Tensor) -> Tensor:
    return (values * known).sum() / known.sum().clamp(min=1)


def _alike(tiles: Iterable[Tile]) -> Iterator[list[Tile]]:
    """Yield tiles in their order, as many at once as are of one size and not too many pixels."""
    part: list[Tile] = []
    for tile in tiles:
        if part and (tile.rgb.shape != part[0].rgb.shape or (len(part) + 1) * tile.rgb[0].size > VALIDATION_PIXELS):
            yield part
            part = []
        part.append(tile)
    if part:
        yield part


def _ahead(make: Callable[[int], Batch], count: int) -> Iterator[Batch]:
    """Yield `make(0)` to `make(count - 1)`, made by a thread while the one before is used."""
    with ThreadPoolExecutor(1) as pool:
        waiting = deque(pool.submit(make, number) for number in range(min(BATCHES_AHEAD, count)))
        for number in range(count):
            batch = waiting.popleft().result()
            if number + BATCHES_AHEAD < count:
                waiting.append(pool.submit(make, number + BATCHES_AHEAD))
            yield batch
