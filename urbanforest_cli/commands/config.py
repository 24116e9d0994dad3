"""``urbanforest config``: show, check and start configs."""

from __future__ import annotations

import json
from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.group(short_help="Show, check and start configs.")
def command() -> None:
    """Show, check and start configs.

    \b
    Example:
        urbanforest config init my.toml
        urbanforest config show -c my.toml
    """


@command.command()
@options.config_opts
@options.json_opt
@options.talk_opts
def show(config_path: Path | None, settings: tuple[str, ...], seed: int | None, as_json: bool) -> None:
    """Print every value in force and where it comes from; all mistakes are reported at once."""
    from urbanforest_cli.core.params import strategy_names
    from urbanforest_cli.files.configs import load_config

    loaded = load_config(config_path, settings=settings, seed=seed, known_strategies=strategy_names())
    values = loaded.config.model_dump(mode="json", exclude_none=True)
    if as_json:
        click.echo(json.dumps({"config": values, "origins": loaded.origins}, indent=2, ensure_ascii=False))
        return
    section = None
    for key, value in _leaves(values):
        name, _, leaf = key.rpartition(".")
        if name != section:
            click.echo(f"\n[{name}]" if name else "")
            section = name
        origin = next((where for path, where in loaded.origins.items() if path == key), "built in")
        click.echo(f"{f'{leaf} = {json.dumps(value, ensure_ascii=False)}':<52} # {origin}")


def _leaves(table: dict[str, object], prefix: str = "") -> list[tuple[str, object]]:
    found: list[tuple[str, object]] = []
    for key, value in sorted(table.items(), key=lambda item: isinstance(item[1], dict)):
        found += _leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else [(prefix + key, value)]
    return found


@command.command()
def schema() -> None:
    """Print the JSON schema of a config, with the meaning of every key."""
    from urbanforest_cli.core.config import Config

    click.echo(json.dumps(Config.model_json_schema(), indent=2, ensure_ascii=False))


@command.command()
@click.argument("path", type=options.FilePath(), default="urbanforest.toml")
@options.overwrite_opt
def init(path: Path, overwrite: bool) -> None:
    """Write the default config to PATH, ready to be changed."""
    from urbanforest_cli.core.errors import OutputExistsError
    from urbanforest_cli.core.publish import write_text
    from urbanforest_cli.files.configs import default_config_path

    if path.exists() and not overwrite:
        raise OutputExistsError("there is a file already", where=path, next_step="name another, or add --overwrite")
    write_text(path, default_config_path().read_text(encoding="utf-8"))
    click.echo(f"Wrote {path}. Use it with `urbanforest populate CITY.gpkg -c {path}`.")
