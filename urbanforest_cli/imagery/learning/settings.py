"""How a coverage network is trained: presets, what may be changed of them, and the rate at each step."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from urbanforest_cli.core.learning_rate import one_cycle

Preset = Literal["small", "pix2pix"]
Loss = Literal["bce", "l1", "l1+gan"]
Precision = Literal["auto", "fp32", "bf16"]
Device = Literal["auto", "cpu", "cuda"]

PRESETS: tuple[Preset, ...] = ("small", "pix2pix")
LOSSES: tuple[Loss, ...] = ("bce", "l1", "l1+gan")
PATIENCE_LEAST = 5
SHARES = ("transfer", "blur")
"""What of the jitter is a share of crops, not a spread."""
PIX2PIX_DOWNS_LEAST = 5


@dataclass(frozen=True, kw_only=True)
class Jitter:
    """Spread of the random change of colours; all are standard deviations, of logarithms where they multiply.

    Parameters
    ----------
    gain, channel_gain, gamma, contrast, saturation
        Of a factor on all channels, of one on each channel, of the exponent after them, of the distance to a medium
        gray, and of the distance of a pixel's channels to their mean.
    channel_offset, noise
        Of a value from 0 to 1 added to each channel, and to each pixel of each channel.
    zoom
        Of the factor by which a crop is shown larger or smaller than it is: imagery is not as sharp as its pixels.
    transfer
        Not a spread but a share: of crops that first get the mean and contrast that another group's images have in
        each channel, or part of the way there, or a little beyond.
    blur
        A share, too: of crops that are blurred, by a Gaussian of up to `BLUR_MOST_PX`.
    """

    gain: float = 0.16
    channel_gain: float = 0.05
    gamma: float = 0.12
    contrast: float = 0.0
    saturation: float = 0.0
    channel_offset: float = 0.025
    noise: float = 0.008
    zoom: float = 0.15
    transfer: float = 0.3
    blur: float = 0.4

    def scaled(self, strength: float) -> Jitter:
        """Return all spreads times a number; shares stay."""
        spreads = {name: value * strength for name, value in asdict(self).items() if name not in SHARES}
        return replace(self, **spreads)


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """All that decides a training but its data.

    Parameters
    ----------
    preset
        The kind of network, and where the other values came from.
    filters, downs
        Channels of the first level, and how often the network halves the image.
    loss
        `bce`: cross entropy with the covered share. `l1`: mean difference to it, both from -1 to 1. `l1+gan`: the
        same `l1_weight` times, and what a discriminator of patches says.
    rate
        `one-cycle`: up within `warm_up_fraction` of all steps, then down, by cosines, the momentum against it.
        `constant-linear`: constant for the first half of the epochs, linear to 0 in the second.
    learning_rate, momentum, weight_decay
        The highest rate; Adam's first beta, where a cycle does not move it; AdamW's decay, 0 is plain Adam.
    batch, crop_px
        Crops a step, and their side in pixels of the model's resolution.
    load_px
        Images are enlarged by `load_px / crop_px` before they are cropped, as Pix2Pix enlarges images of 256 pixels
        to 286. The model is then one of a finer resolution, which it states.
    dihedral
        Show crops in all eight orientations; else as they are or with left and right exchanged.
    epochs
        An epoch shows each image as many times as crops fit into its area, at least once.
    patience
        Stop after so many epochs without a better validation; 0 never, None a quarter of the epochs, at least 5.
    """

    preset: Preset = "small"
    filters: int = 16
    downs: int = 3
    loss: Loss = "bce"
    l1_weight: float = 100.0
    rate: Literal["one-cycle", "constant-linear"] = "one-cycle"
    warm_up_fraction: float = 0.1
    learning_rate: float = 3e-3
    momentum: float = 0.9
    weight_decay: float = 1e-2
    batch: int = 8
    crop_px: int = 128
    load_px: int = 128
    dihedral: bool = True
    jitter: Jitter | None = Jitter()
    epochs: int = 16
    patience: int | None = None
    seed: int = 0

    @property
    def multiple_px(self) -> int:
        """Sides of images the network takes are multiples of this."""
        return 1 << self.downs

    @property
    def magnification(self) -> float:
        """How much larger images are shown than they are."""
        return self.load_px / self.crop_px

    @property
    def patience_epochs(self) -> int:
        """The patience as a number; 0 is without end."""
        return max(PATIENCE_LEAST, self.epochs // 4) if self.patience is None else self.patience

    def decisive(self) -> dict[str, Any]:
        """Return what decides the weights of an epoch; when to stop does not."""
        return {name: value for name, value in asdict(self).items() if name != "patience"}

    def faults(self) -> list[str]:
        """Return a sentence for each value that cannot be."""
        fewest = PIX2PIX_DOWNS_LEAST if self.preset == "pix2pix" else 1
        checks = {
            "crop_px must be a multiple of 2^downs": self.crop_px > 0 and self.crop_px % self.multiple_px == 0,
            "crop_px must be at most 2048": self.crop_px <= 2048,
            "load_px must lie within crop_px and twice that": self.crop_px <= self.load_px <= 2 * self.crop_px,
            f"downs must lie within {fewest} and 10": fewest <= self.downs <= 10,
            "batch must lie within 1 and 1024": 1 <= self.batch <= 1024,
            "epochs must lie within 1 and 100000": 1 <= self.epochs <= 100_000,
            "learning_rate must lie within 0 and 1": 0.0 < self.learning_rate <= 1.0,
            "patience must not be below 0": self.patience is None or self.patience >= 0,
            "small with batch 1 has no batch to normalise over when crops are one pixel at the innermost level":
            self.preset == "pix2pix" or self.batch > 1 or self.crop_px > self.multiple_px,
        }  # fmt: skip
        return [text for text, holds in checks.items() if not holds]


SMALL = TrainingSettings()
PIX2PIX = TrainingSettings(
    preset="pix2pix", filters=64, downs=8, loss="l1+gan", l1_weight=100.0, rate="constant-linear", warm_up_fraction=0.0,
    learning_rate=2e-4, momentum=0.5, weight_decay=0.0, batch=1, crop_px=256, load_px=286, dihedral=False, jitter=None,
    epochs=200, patience=0,
)  # fmt: skip
"""The defaults of Isola et al. (2017) and of their PyTorch release: 100 epochs and 100 of decay, beta2 0.999."""


def settings_for(
    preset: Preset,
    *,
    crop_px: int | None = None,
    jitter: float | None = None,
    transfer: float | None = None,
    **changes: Any,
) -> TrainingSettings:
    """Return a preset with changes; those that are None change nothing.

    Parameters
    ----------
    crop_px
        Changes `load_px` with it, so that the preset's enlargement stays.
    jitter
        Strength of the change of colours: times the spreads of `Jitter`, 0 for none.
    transfer
        Share of crops with the colours of another group; see `Jitter`.
    """
    base = PIX2PIX if preset == "pix2pix" else SMALL
    given = {name: value for name, value in changes.items() if value is not None}
    if crop_px is not None:
        given |= {"crop_px": crop_px, "load_px": round(crop_px * base.magnification)}
    if jitter is not None:
        given["jitter"] = Jitter().scaled(jitter) if jitter > 0 else None
    if transfer is not None:
        given["jitter"] = replace(given.get("jitter", base.jitter) or Jitter().scaled(0.0), transfer=transfer)
    return replace(base, **given)


def rate_at(settings: TrainingSettings, step: int, steps_an_epoch: int) -> tuple[float, float]:
    """Return the learning rate and Adam's first beta of a step, counted from 0 over all epochs.

    A function of the step alone, so that a training that goes on needs no memory of it.
    """
    if settings.rate == "constant-linear":
        decaying = settings.epochs // 2
        constant = settings.epochs - decaying
        beyond = max(0, step // steps_an_epoch + 1 - constant)
        return settings.learning_rate * (1.0 - beyond / (decaying + 1)), settings.momentum
    return one_cycle(
        step, settings.epochs * steps_an_epoch,
        highest=settings.learning_rate, warm_up_fraction=settings.warm_up_fraction,
    )  # fmt: skip
