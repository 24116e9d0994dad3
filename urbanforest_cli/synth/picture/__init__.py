"""An aerial picture of a procedural city, and what in it is green."""
