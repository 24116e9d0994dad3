"""Functional zones of a city (paper, section Planting Rules) and how they look on a map."""

from __future__ import annotations

ZONES = ("residential", "commercial", "industrial", "street", "other")
FALLBACK_ZONE = "other"
ZONE_COLOURS = {
    "residential": "#f6eddc",
    "commercial": "#f5dfe0",
    "industrial": "#e4e1ee",
    "street": "#e9e9e6",
    "other": "#e3efd6",
}
