"""The two-alternative study: which of two plantings looks more realistic (paper, section Perceptual User Study)."""
