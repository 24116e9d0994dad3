"""Judging the parameter model: scores, baselines, calibration, on frozen designs and on held-out lots."""
