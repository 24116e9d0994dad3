"""Run the command line by ``python -m urbanforest_cli``."""

from urbanforest_cli.main import run

run()
