"""Which bands of a raster file are its colours, as far as the file says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.notices import Notices

GRAY = "image files without colour, gray taken as red, green and blue: plants are told by colour, so trust little"
_NIR_WORDS = ("nir", "near infrared", "near-infrared", "nearinfrared", "infrared", "b8", "b08")
_COLOUR_WORDS = {
    "red": ("red", "r", "b4", "b04"),
    "green": ("green", "g", "b3", "b03"),
    "blue": ("blue", "b", "b2", "b02"),
}


@dataclass(frozen=True)
class ImageTraits:
    """What the bands of an image are; bands are counted from 1.

    Parameters
    ----------
    red, green, blue
        All the same for a gray image or one with a palette.
    nir, alpha
        None where there is none.
    dtype
        Of the samples in the file.
    nodata
        A pixel whose colours all have it is missing.
    low, high
        Samples that become 0 and 255.
    palette
        Colours by index, (n, 4) uint8: red, green, blue, alpha.
    masked
        The file carries a mask of its own.
    black_is_missing
        Pure black stands for missing, though the file does not say so.
    alpha_least
        Of transparency, from which on a pixel is there.
    """

    band_count: int
    red: int
    green: int
    blue: int
    nir: int | None
    alpha: int | None
    dtype: str
    nodata: float | None
    low: float = 0.0
    high: float = 255.0
    palette: NDArray[np.uint8] | None = None
    masked: bool = False
    black_is_missing: bool = False
    alpha_least: float = 128.0

    @property
    def gray(self) -> bool:
        """Tell whether one band stands for all three colours."""
        return self.palette is None and self.red == self.green == self.blue

    @property
    def stretched(self) -> bool:
        """Tell whether samples are not taken as they are."""
        return (self.low, self.high) != (0.0, 255.0)

    @property
    def bands(self) -> tuple[int, int, int]:
        """Return the bands of red, green and blue."""
        return self.red, self.green, self.blue

    def sentence(self) -> str:
        """Say how the bands are read, for a user to check."""
        if self.palette is not None:
            parts = [f"palette of {len(self.palette)} colours in band {self.red} of {self.band_count}"]
        elif self.gray:
            parts = [f"gray from band {self.red} of {self.band_count}"]
        else:
            parts = [f"red {self.red}, green {self.green}, blue {self.blue} of {self.band_count} bands"]
        parts += [f"near infrared {self.nir}"] if self.nir else []
        parts += [f"transparency {self.alpha}"] if self.alpha else []
        parts += ["its own mask"] if self.masked else []
        parts += [f"no data {self.nodata:g}"] if self.nodata is not None else []
        parts += ["pure black taken for no data"] if self.black_is_missing else []
        parts += [f"{self.dtype} from {self.low:g} to {self.high:g} brought to 0 to 255"] if self.stretched else []
        return ", ".join(parts)


def find_bands(dataset: Any, path: Path, chosen: tuple[int, ...] | None, notices: Notices) -> ImageTraits:
    """Tell the bands of an open raster by what it says of them, or as chosen.

    What a file calls alpha is believed here; `image_values.check_alpha` looks at it.

    Raises
    ------
    ConfigError
        Bands chosen that are not there.
    InputError
        Inks (CMYK), which are no colours of light.
    """
    count = int(dataset.count)
    meanings = [entry.name for entry in dataset.colorinterp]
    words = [(text or "").strip().lower() for text in dataset.descriptions]
    if {"cyan", "magenta"} <= set(meanings):
        raise InputError(
            "colours are stored in a way that is not read", where=path, found="inks (CMYK)",
            expected="red, green and blue", next_step="convert it to RGB, for instance with GIMP",
        )  # fmt: skip
    palette = _palette(dataset) if count <= 2 else None
    colours = _chosen(chosen, count) or _colours(meanings, words, path, notices, palette is not None)
    alpha = meanings.index("alpha") + 1 if "alpha" in meanings else None
    alpha = None if alpha in colours else alpha
    flags = [flag.name for flag in dataset.mask_flag_enums[colours[0] - 1]]
    return ImageTraits(
        band_count=count, red=colours[0], green=colours[1], blue=colours[2],
        nir=_nir(meanings, words, colours), alpha=alpha, dtype=str(dataset.dtypes[colours[0] - 1]),
        nodata=_nodata(dataset, colours, path, notices), palette=palette,
        masked="per_dataset" in flags and "alpha" not in flags,
    )  # fmt: skip


def _chosen(bands: tuple[int, ...] | None, count: int) -> tuple[int, int, int] | None:
    if bands is None:
        return None
    if len(bands) not in (1, 3) or not all(1 <= band <= count for band in bands):
        raise ConfigError(
            "these bands cannot be read as colours", where="--bands", found=",".join(map(str, bands)),
            expected=f"the numbers of red, green and blue, or of one band for gray, each 1 to {count}",
        )  # fmt: skip
    return (bands[0], bands[0], bands[0]) if len(bands) == 1 else (bands[0], bands[1], bands[2])


def _colours(
    meanings: list[str], words: list[str], path: Path, notices: Notices, paletted: bool
) -> tuple[int, int, int]:
    if {"red", "green", "blue"} <= set(meanings):
        return meanings.index("red") + 1, meanings.index("green") + 1, meanings.index("blue") + 1
    named = [next((i + 1 for i, text in enumerate(words) if text in _COLOUR_WORDS[name]), 0) for name in _COLOUR_WORDS]
    if all(named):
        return named[0], named[1], named[2]
    usable = [i + 1 for i, meaning in enumerate(meanings) if meaning != "alpha"] or [1]
    if len(usable) >= 3:
        notices.add("W_BANDS_ASSUMED", "image files that do not name their bands, the first three taken as red, green "
                    "and blue", 1, [path.name])  # fmt: skip
        return usable[0], usable[1], usable[2]
    if not paletted:
        notices.add("W_GRAY", GRAY, 1, [path.name])
    return usable[0], usable[0], usable[0]


def _nir(meanings: list[str], words: list[str], colours: tuple[int, int, int]) -> int | None:
    """Find near infrared: what says so, or else the fourth of four bands that says nothing."""
    for i, (meaning, text) in enumerate(zip(meanings, words, strict=True)):
        if i + 1 not in colours and (meaning == "nir" or text in _NIR_WORDS):
            return i + 1
    silent = len(meanings) == 4 and meanings[3] in ("undefined", "gray") and not words[3]
    return 4 if silent and 4 not in colours and len(set(colours)) == 3 else None


def _nodata(dataset: Any, colours: tuple[int, int, int], path: Path, notices: Notices) -> float | None:
    """Return the value that marks missing pixels; None where it is none the samples can have."""
    value = dataset.nodatavals[colours[0] - 1]
    if value is None:
        return None
    kind = np.dtype(dataset.dtypes[colours[0] - 1])
    possible = kind.kind == "f" or (float(value).is_integer() and np.iinfo(kind).min <= value <= np.iinfo(kind).max)
    if not possible:
        notices.add("W_NODATA", "image files whose nodata value no pixel can have, left out", 1, [path.name])
        return None
    return float(value)


def _palette(dataset: Any) -> NDArray[np.uint8] | None:
    try:
        table = dataset.colormap(1)
    except ValueError:
        return None
    colours = np.zeros((max(table) + 1, 4), dtype=np.uint8)
    for index, colour in table.items():
        colours[index] = colour
    return colours
