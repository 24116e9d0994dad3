"""Colours as ``#rrggbb``: those that files choose, and steady ones for what has none."""

from __future__ import annotations

import colorsys
import re
from collections.abc import Mapping
from hashlib import blake2b

from urbanforest_cli.core.zones import ZONE_COLOURS

HEX = re.compile(r"#[0-9a-fA-F]{6}")


def zone_colour(zone: str, chosen: Mapping[str, str] | None = None) -> str:
    """Return a zone's fill: the one chosen, else the shipped one, else a pale one of its own made from its name."""
    colour = (chosen or {}).get(zone) or ZONE_COLOURS.get(zone)
    return colour if colour and HEX.fullmatch(colour) else named_colour(zone, lightness=0.91, saturation=0.35)


def species_colour(species: str, chosen: Mapping[str, str] | None = None) -> str:
    """Return a species' colour: the one chosen, else a green of its own made from its name."""
    colour = (chosen or {}).get(species)
    return colour if colour and HEX.fullmatch(colour) else named_colour(species, low=0.15, high=0.5)


def named_colour(
    name: str, *, lightness: float = 0.45, saturation: float = 0.38, low: float = 0.0, high: float = 1.0
) -> str:
    """Return a colour whose hue, between two turns of the wheel, hangs on a name alone."""
    share = int.from_bytes(blake2b(name.encode("utf-8", "surrogatepass"), digest_size=4).digest(), "little") / 2**32
    return to_hex(colorsys.hls_to_rgb(low + (high - low) * share, lightness, saturation))


def to_rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue from 0 to 1."""
    return tuple(int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))  # type: ignore[return-value]


def to_hex(rgb: tuple[float, float, float]) -> str:
    """Return ``#rrggbb``."""
    return "#" + "".join(f"{round(255 * min(max(part, 0.0), 1.0)):02x}" for part in rgb)


def mixed(colour: str, other: str, share: float) -> str:
    """Return a colour with a share of another in it."""
    return to_hex(tuple(a + (b - a) * share for a, b in zip(to_rgb(colour), to_rgb(other), strict=True)))  # type: ignore[arg-type]
