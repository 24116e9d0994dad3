"""The terminal: the only folder that speaks click; a file a subcommand."""
