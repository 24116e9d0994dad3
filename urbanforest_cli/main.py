"""The command line: a table of commands imported on use, and one place where errors become messages."""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
from types import FrameType

import click

from urbanforest_cli import __version__
from urbanforest_cli.core.cache import ensure_cache_folders
from urbanforest_cli.core.errors import EXIT_INTERNAL, EXIT_IO, UrbanForestError

COMMANDS = {
    "populate": ("populate", "Fill a city with plants: all stages, and the files people open."),
    "import": ("import_", "Make a city file from land registers, OSM, Overture and the like."),
    "synth": ("synth", "Make a procedural city for demos, tests and scale."),
    "stencil": ("stencil", "Cut out of each lot the ground that may be planted."),
    "regress": ("regress", "Read each lot's parameters off its coverage, and how sure they are."),
    "diffuse": ("diffuse", "Let neighbouring lots share their parameters."),
    "place": ("place", "Place plants in the ground of each lot."),
    "grow": ("grow", "Grow every plant into a skeleton, in the sight of its neighbours and of buildings."),
    "export": ("export", "Write a planted city as glTF, 3D Tiles, CityJSON, OBJ, tables and canopy rasters."),
    "render": ("render", "Draw a planted city: from above, in perspective, from the street."),
    "verify": ("verify", "Hold every output of a city against its register."),
    "evaluate": ("evaluate", "Judge placed plants against real ones."),
    "cover": ("cover", "Map the vegetation in an aerial image."),
    "train-coverage": ("train_coverage", "Train a network to map vegetation, from images and masks."),
    "evaluate-coverage": ("evaluate_coverage", "Judge coverage maps and models against masks, beside baselines."),
    "train-regression": ("train_regression", "Train a network to read placement parameters off coverage."),
    "evaluate-regression": ("evaluate_regression", "Judge a parameter model beside baselines, and how sure it is."),
    "study": ("study", "Write a questionnaire: which of two plantings, placed or real, looks more realistic?"),
    "study-score": ("study_score", "Score the answers to a study."),
    "figures": ("figures", "Render the paper's figures with this program's own strategies and plants."),
    "config": ("config", "Show, check and start configs."),
    "info": ("info", "Tell where an output comes from, or what a parameter means."),
}


class CommandTable(click.Group):
    """A group that imports a command only when it is called, so that ``--help`` is instant."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands in the order of the pipeline."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command's module and return its ``command``."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"urbanforest_cli.commands.{COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        command.name = cmd_name
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from the table, importing none."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Suggest the nearest command for a mistyped one."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            from difflib import get_close_matches

            near = get_close_matches(args[0], COMMANDS, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            ctx.fail(f"No such command {args[0]!r}.{hint}")
        return super().resolve_command(ctx, args)


@click.group(
    cls=CommandTable,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "auto_envvar_prefix": "URBANFOREST",
        "max_content_width": 110,
    },
)
@click.version_option(__version__, prog_name="urbanforest")
def cli() -> None:
    """Fill a city with trees.

    \b
    urbanforest populate city.gpkg            plant a city by the rules of its zones
    urbanforest import SOURCE... -o city.gpkg  make that file from what you have
    urbanforest COMMAND --help                 what a command reads, writes and takes

    Exit codes: 0 all is well, 1 a fault of the program, 2 bad input, config or usage, 3 done but more lots were
    bad than --max-bad allows, 74 an output could not be written, 75 another run holds the output, 128+N signal N.
    """


class _Stopped(BaseException):
    def __init__(self, number: int) -> None:
        self.number = number


def _stop(number: int, frame: FrameType | None) -> None:
    raise _Stopped(number)


def run() -> None:
    """Run the command line and leave with the documented exit code."""
    ensure_cache_folders()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup stays nohup
            signal.signal(number, _stop)
    sys.exit(guarded(sys.argv[1:]))


def guarded(arguments: list[str]) -> int:
    """Run one command line and return its exit code; every error becomes a message on standard error."""
    try:
        cli.main(args=arguments, prog_name="urbanforest", standalone_mode=False)
        sys.stdout.flush()
    except _Stopped as stopped:
        going_on = "; the next run goes on from the last stage" if arguments[:1] == ["populate"] else ""
        _say(f"Stopped by signal {stopped.number}. Outputs are as they were{going_on}.")
        return 128 + stopped.number
    except click.exceptions.Exit as done:
        return int(done.exit_code)
    except click.Abort:
        return 128 + signal.SIGINT
    except click.ClickException as error:
        error.show(sys.stderr)
        return error.exit_code
    except UrbanForestError as error:
        if "--json" in arguments:
            click.echo(json.dumps(error.as_record(), ensure_ascii=False))
        _say(f"Error: {error.message()}")
        return error.exit_code
    except BrokenPipeError:
        # The reader of our output left; nothing more can be said to it, not even by the interpreter's own flush.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as error:
        _say(f"Error: {error}")
        return EXIT_IO
    except MemoryError:
        _say("Error: out of memory\n  next:     run with fewer --workers, or on a part of the city")
        return EXIT_IO
    except Exception as error:
        if "--debug" in arguments:
            raise
        _say(
            f"Internal error, a fault of this program: {type(error).__name__}: {error}\n"
            "  next:     run again with --debug for the traceback and report it"
        )
        return EXIT_INTERNAL
    return 0


def _say(text: str) -> None:
    click.echo(text, err=True)
