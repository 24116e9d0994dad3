"""Judging coverage maps against truth, beside baselines."""
