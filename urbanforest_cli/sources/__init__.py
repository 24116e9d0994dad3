"""Sources: what people have, made into a city file."""
