"""A planted city as one scene: arrays of plants, the shapes they share, buildings and ground."""
