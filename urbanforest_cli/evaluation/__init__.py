"""Evaluation: placed plants against real ones, lot by lot, beside references that know nothing of either."""
