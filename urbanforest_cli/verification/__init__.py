"""Whether all outputs say the same as the register: the same plants, in the same places, and no file changed since."""
