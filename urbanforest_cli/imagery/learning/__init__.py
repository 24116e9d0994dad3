"""Teaching the coverage model: pairs, labels, networks, training. torch stays in `network` and `training`."""
