"""Stage: from the coverage of a lot to the parameters of its placement."""
