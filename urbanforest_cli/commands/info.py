"""``urbanforest info``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Tell where an output comes from, or what a parameter means.")
@click.argument("path", type=options.FilePath(), required=False, metavar="[FILE]")
@click.option("--params", is_flag=True, help="Print the glossary of parameters.")
@click.option("--strategies", is_flag=True, help="Print the placement strategies, plug-ins included.")
@options.json_opt
@options.talk_opts
def command(path: Path | None, params: bool, strategies: bool, as_json: bool) -> None:
    """Print the provenance of FILE, any output of this program; of a folder of them, that of its register.

    \b
    Example:
        urbanforest info rome-forest
        urbanforest info rome-forest/forest.glb
        urbanforest info --params
    """
    if params:
        _print_parameters(as_json)
    if strategies:
        _print_strategies(as_json)
    if path is not None:
        from urbanforest_cli.files.describe import describe_output

        record = describe_output(path)
        if as_json:
            click.echo(json.dumps(record, indent=2, ensure_ascii=False))
        else:
            _print_record(record)
    elif not (params or strategies):
        raise click.UsageError("Name a FILE, or ask for --params or --strategies.")


def _print_parameters(as_json: bool) -> None:
    from dataclasses import asdict

    from urbanforest_cli.core.params import PARAMETERS

    if as_json:
        click.echo(json.dumps([asdict(p) for p in PARAMETERS.values()], indent=2, ensure_ascii=False))
        return
    click.echo(f"{'name':<22}{'symbol':<8}{'unit':<7}{'default':>8}  {'table range':<12}{'limits':<12}meaning")
    for p in PARAMETERS.values():
        ranges = f"{f'{p.low:g}-{p.high:g}':<12}{f'{p.minimum:g}-{p.maximum:g}':<12}"
        click.echo(f"{p.name:<22}{p.symbol:<8}{p.unit:<7}{p.default:>8g}  {ranges}{p.doc}")


def _print_strategies(as_json: bool) -> None:
    from urbanforest_cli.core.params import strategy_names

    names = strategy_names()
    click.echo(json.dumps(list(names)) if as_json else "\n".join(names))


def _print_record(record: dict[str, object], indent: str = "") -> None:
    for key, value in record.items():
        if isinstance(value, dict):
            click.echo(f"{indent}{key}:")
            _print_record(value, indent + "  ")
        elif isinstance(value, list):
            click.echo(f"{indent}{key}:" + ("" if value else " none"))
            for item in value:
                text = ", ".join(f"{k} {v}" for k, v in item.items()) if isinstance(item, dict) else str(item)
                click.echo(f"{indent}  - {text}")
        else:
            click.echo(f"{indent}{key}: {value}")
