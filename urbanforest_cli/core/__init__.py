"""Words every stage speaks: parameters, config, schema, randomness, errors, publishing."""
