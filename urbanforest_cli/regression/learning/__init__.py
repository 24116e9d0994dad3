"""Teaching the parameter model: networks, training, export. torch stays in `network` and `training`."""
