"""The options -v and --log-file, which every command has."""

import logging
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.main

from goniotwin.app import log_file as log
from goniotwin.app.errors import UserError, unusable


def _log_to_file(context: typer.Context, path: Path | None) -> None:
    """Write the log to a file until the end of the command. Raises UserError."""
    if path is None or context.resilient_parsing:
        return
    try:
        handler = log.LogFile(path)
    except FileExistsError as error:
        raise UserError(f"{error}, and is left as it is; name another file for --log-file") from None
    except OSError as error:
        raise unusable(path, "the log cannot be written", error, "name a file in a folder that you can write to") from None
    _log_until_end(context, handler)


def _log_to_screen(context: typer.Context, times: int) -> None:
    """Write the log to standard error until the end of the command."""
    if times and not context.resilient_parsing:
        _log_until_end(context, log.LogOnScreen(logging.INFO if times == 1 else logging.DEBUG))


def _log_until_end(context: typer.Context, handler: logging.Handler) -> None:
    level = log.begin_log(handler)
    context.find_root().call_on_close(lambda: log.end_log(handler, level))
    log.log_start(handler)


def _options(
    _log_file: Annotated[
        Path | None,
        typer.Option(
            "--log-file", metavar="FILE", callback=_log_to_file, help="Append the whole log to this file.", show_default=False
        ),
    ] = None,
    _verbose: Annotated[
        int,
        typer.Option(
            "-v", count=True, callback=_log_to_screen, help="Log on standard error. -vv adds rows and failed attempts."
        ),
    ] = 0,
) -> None:
    """The options, as typer reads them."""


def add_log_options(command: Any) -> None:
    """Give the options to a command, and to those of a group."""
    only = typer.Typer(add_completion=False)
    only.command()(_options)
    options = [each for each in typer.main.get_command(only).params if each.name != "help"]
    for each in options:
        each.expose_value = False
    command.params.extend(options)
    for each in getattr(command, "commands", {}).values():
        add_log_options(each)
