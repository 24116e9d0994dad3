"""urbanforest: fill a city with trees."""

__version__ = "0.1.0"
