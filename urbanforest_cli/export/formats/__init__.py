"""The formats a planted city is written in, each by its name on the command line."""
