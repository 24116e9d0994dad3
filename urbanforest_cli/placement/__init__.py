"""Active areas to plants: the six strategies, thinning by density, and what each plant is."""
