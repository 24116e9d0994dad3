"""Stage ``stencil``: from a city to a register with the ground where plants may stand."""
