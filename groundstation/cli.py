"""The console command ``groundstation``: finds the command, runs it, prints its result or its refusal, sets the
status.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TextIO

import click

from groundstation import __version__
from groundstation.commands.common import ProgressLine, Result, suggestion
from groundstation.commands.listing import SECTIONS
from groundstation.errors import BadInput, GroundStationError, Refused
from groundstation.texts import shown

COMMANDS = {
    "plan": "planning",
    "sim": "flying",
    "rehearse": "flying",
    "preflight": "flying",
    "fly": "flying",
    "identify": "analysing",
    "predict": "analysing",
    "diagnose": "analysing",
    "report": "analysing",
    "compare": "files",
    "export": "files",
    "convert": "files",
    "flights": "fleet",
    "batch": "fleet",
    "campaign": "campaign",
    "calibrate": "mocap",
    "doctor": "station",
    "completion": "station",
    "reproduce": "station",
    "station": "sharing",
}
"""Command -> module of ``groundstation.commands`` that holds it."""

INTERRUPTED = 130


class LazyGroup(click.Group):
    """Imports the module of a command when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """In the order in which one uses them."""
        return [name for section in SECTIONS.values() for name in section]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A section for each purpose, a line for each command."""
        width = max(map(len, COMMANDS))
        for title, commands in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), line) for name, line in commands.items()])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a name."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"groundstation.commands.{COMMANDS[cmd_name]}")
        return getattr(module, cmd_name)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command, or a fault that names the nearest ones."""
        name = args[0] if args else ""
        if name and name not in COMMANDS and not name.startswith("-"):
            raise click.UsageError(f"there is no command '{name}'. {suggestion(name, COMMANDS)}")
        return super().resolve_command(ctx, args)


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    invoke_without_command=True,
    epilog="\b\nExample:\n  groundstation rehearse     a whole flight in simulation",
)
@click.version_option(__version__, prog_name="groundstation")
@click.option("--debug", is_flag=True, help="Show where an error comes from.")
@click.option("--serve", is_flag=True, help="Offer the terminal UI to a browser, on this machine alone.")
@click.option("--station", metavar="HOST", help="Show the station on another machine, which gave a pass for it.")
@click.pass_context
def cli(ctx: click.Context, debug: bool, serve: bool, station: str | None) -> Any:
    """Turn one short flight of a quadrotor into a model of it that can be trusted.

    Without a command it opens the terminal UI.
    """
    if ctx.invoked_subcommand is not None:
        if station is not None:
            raise click.UsageError("--station opens the terminal UI; it takes no command.")
        return None
    if serve and station is not None:
        raise click.UsageError("--serve shows this station; give --station without it.")
    try:
        ui = importlib.import_module("groundstation.tui.serve" if serve else "groundstation.tui.app")
    except ModuleNotFoundError:
        click.echo(ctx.get_help())
        return None
    return ui.serve() if serve else ui.run(station)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status and never shows a traceback unless ``--debug`` is given."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in arguments
    with _standard_output(as_json) as out:
        try:
            result = cli.main(args=arguments, prog_name="groundstation", standalone_mode=False)
        except (click.Abort, KeyboardInterrupt):
            return _fail("interrupted", INTERRUPTED, as_json, out)
        except click.ClickException as error:
            return _fail(_called(error), BadInput.exit_status, as_json, out)
        except Refused as error:
            return _fail(str(error), error.exit_status, as_json, out, reason=error)
        except GroundStationError as error:
            return _fail(str(error), error.exit_status, as_json, out)
        except Exception as error:
            if isinstance(error, BrokenPipeError) and not _print("", sys.stdout, end=""):
                return 0
            if "--debug" in arguments:
                raise
            text = (
                f"this is a defect of groundstation ({type(error).__name__}: {error}); `groundstation --debug ...` "
                "shows where"
            )
            return _fail(text, 1, as_json, out)
        if isinstance(result, Result):
            from groundstation.analysis.documents import finite

            _print(_json(finite(result.document)) if as_json else shown(result.text, limit=_MOST, lines=True), out)
            return result.exit_status
        _print("", sys.stdout, end="")
        return result if isinstance(result, int) else 0


def _called(error: click.ClickException) -> str:
    """A fault of the command line; where something is missing or too much, with what shows how it is called."""
    text = error.format_message()
    context = getattr(error, "ctx", None)
    if context is None or (isinstance(error, click.BadParameter) and not isinstance(error, click.MissingParameter)):
        return text
    return f"{text.rstrip('.')}. `{context.command_path} -h` shows how it is called."


def _print(text: str, out: TextIO, end: str = "\n") -> bool:
    """Print it all now; False where the reader has gone (`| head`), and what is left then goes nowhere."""
    try:
        print(text, file=out, end=end, flush=True)
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, out.fileno())
        os.close(nowhere)
        return False
    return True


def _fail(text: str, status: int, as_json: bool, out: TextIO, reason: Refused | None = None) -> int:
    """One sentence on standard error, and as JSON on standard output where that was asked for."""
    ProgressLine.end_open()
    print(shown(text), file=sys.stderr)
    if as_json:
        document: dict[str, Any] = {"error": text, "exit_status": status}
        if reason is not None:
            from groundstation.analysis.documents import refusal

            document |= refusal(reason)
        _print(_json(document), out)
    return status


_MOST = 10_000_000
_C1 = {
    code: f"\\u{code:04x}"
    for code in (*range(0x7F, 0xA0), 0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
}
"""What JSON lets stand in a text and a terminal acts on, as the escapes that mean the same."""


def _json(document: Any) -> str:
    return json.dumps(document, ensure_ascii=False).translate(_C1)


@contextmanager
def _standard_output(as_json: bool) -> Iterator[TextIO]:
    """Standard output; with ``--json`` kept for the document alone: what else writes there, solvers too, goes to
    stderr.
    """
    if not as_json:
        yield sys.stdout
        return
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with os.fdopen(os.dup(kept), "w", encoding="utf-8") as out:
            yield out
    finally:
        os.dup2(kept, 1)
        os.close(kept)


if __name__ == "__main__":
    sys.exit(main())
