"""The command `goniotwin`: its groups of commands, the entry point and the last-resort error handler."""

import atexit
import contextlib
import io
import logging
import os
import sys
import threading
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
import typer.main
from typer.core import TyperGroup
from typer.exceptions import TyperException

import goniotwin
from goniotwin import examples
from goniotwin.app.cli import campaign, compilation, data, instrument, serving, simulation, views
from goniotwin.app.cli.logging_options import add_log_options
from goniotwin.app.cli.output import Json, Speed, TranscriptOption, answer, error_console, print_error
from goniotwin.app.end_signals import end_signal_received, ignore_end_signals, interrupt_on_end_signal
from goniotwin.app.errors import UserError, fault_of_named_path, room_on_disk, unexpected_error, unusable
from goniotwin.app.log_file import own_log

LOG = logging.getLogger(__name__)
LOG.addHandler(logging.NullHandler())  # what is logged here is printed too
FAULT = 1
"""Exit status after an unexpected error, and where standard output cannot be written."""
INTERRUPTED = 130
"""Exit status after Ctrl-C: 128 + SIGINT, as of a shell."""
COMMANDS = (
    "doctor",
    "devices",
    "home",
    "here",
    "move",
    "read",
    "verify-device",
    "new",
    "check",
    "rehearse",
    "prove",
    "run",
    "runs",
    "align",
    "verify",
    "budget",
    "closure",
    "export",
    "convert",
    "info",
    "report",
    "plot",
    "compare",
    "render",
    "copy",
    "simulate",
    "tolerances",
    "demo",
    "examples",
    "compile",
    "schema",
    "serve",
    "usb",
    "replay",
    "station",
    "desktop",
)
"""In the order of an operator's day; then what is needed less often."""


class CommandGroup(TyperGroup):
    """The commands in the order of COMMANDS. Typer gives no message for a KeyboardInterrupt; this group prints one."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of the commands, hidden aliases last."""
        del ctx
        return sorted(self.commands, key=lambda name: COMMANDS.index(name) if name in COMMANDS else len(COMMANDS))

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            print_error("stopped")
            raise typer.Exit(INTERRUPTED) from None
        except UserError as error:
            LOG.error("%s", error)
            raise
        except (typer.Exit, TyperException):
            raise
        except Exception:
            LOG.exception("unexpected error")
            raise


class CommandLine(typer.Typer):
    """A command line that a program of another's may call, too: of that process it changes nothing."""

    @cached_property
    def _command(self) -> Any:
        """What typer builds of all functions, which takes 13 ms: once, for a program that calls several commands."""
        command = typer.main.get_command(self)
        add_log_options(command)
        return command

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command. Typer's own way takes over `sys.excepthook`."""
        return self._command(*args, **kwargs)


app = CommandLine(
    cls=CommandGroup,
    name="goniotwin",
    help=(
        "BSDF measurement campaigns on a goniophotometer, and their rehearsal on its digital twin.\n\n"
        "Without a command the window opens, with the virtual rig of the examples."
    ),
    no_args_is_help=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for group in (instrument, campaign, data, views, serving):
    app.add_typer(group.app)
app.add_typer(simulation.app, name="simulate")


def show_version(wanted: bool) -> None:
    """Print the version and exit."""
    if wanted:
        print(f"goniotwin {goniotwin.__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def start(
    context: typer.Context,
    _version: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Open the window if there is no command."""
    compilation.state_compilation()
    context.call_on_close(compilation.state_no_more)
    if context.invoked_subcommand is None:
        desktop(examples.FIRST_RIG, examples.FIRST_SCHEDULE)


@app.command()
def desktop(
    rig: Annotated[
        Path, typer.Option("--rig", metavar="RIG.toml", help="Rig file.", show_default="first.toml of the examples")
    ] = examples.FIRST_RIG,
    schedule: Annotated[
        Path,
        typer.Option("--schedule", metavar="SCHEDULE.toml", help="Schedule file.", show_default="first.toml of the examples"),
    ] = examples.FIRST_SCHEDULE,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for data files (journals).", show_default=False)
    ] = None,
    speed: Speed = 20.0,
) -> None:
    """Open the window."""
    try:
        from goniotwin.app.desktop import run_desktop
    except ImportError as error:
        from goniotwin.app.cli.work.doctor import QT_LIBRARIES

        raise UserError(f"the window needs Qt, which cannot be loaded: {error}; {QT_LIBRARIES}") from None

    with own_log("window"):
        status = run_desktop(rig, schedule, out, speed)
    raise typer.Exit(status)


@app.command()
def tolerances(
    study: Annotated[
        Path,
        typer.Argument(metavar="FILE.toml", help='Study file: page "Tolerances" of the documentation.', show_default=False),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for the figures and the tables as CSV.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Find the tolerances of the instrument.

    The steps are those of the paper's section 3.3: each deviation alone, all combinations, and limits with which none fails.
    The command adds yields, the worst corner, sensitivities, and what remains about the measured peak. All results are
    simulated.
    """
    from goniotwin.app.cli.work.tolerances import print_tolerances

    print_tolerances(study, out, as_json)


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the files.")] = Path("demo"),
    transcript: TranscriptOption = None,
    as_json: Json = False,
) -> None:
    """Measure satin on the virtual rig; compare it with theory.

    The program drives the devices over their real protocols, and measures the hemisphere at two incidences. It writes a
    journal, a CSV file, a figure and a report into a folder. It replaces the files of an earlier demo there.
    """
    from goniotwin.app.cli.work.demo import run_demo

    answer(as_json, *run_demo(examples.FIRST_RIG, examples.FIRST_SCHEDULE, out, transcript, error_console()))


@app.command("compile")
def compile_optics(as_json: Json = False) -> None:
    """Compile the optics once, ahead of the first use.

    Without this command, the first command that needs the optics compiles them. The program keeps the code in files for this
    computer and this version. The results are the same.
    """
    from goniotwin.app.cli.work.compilation import compile_all

    compile_all(as_json)


@app.command("examples")
def copy_examples(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder for the copies. The command creates it if needed.", show_default=False)
    ],
    as_json: Json = False,
) -> None:
    """Copy the example rigs and schedules into a folder.

    Existing files are never overwritten.
    """
    from goniotwin.app.formats.file import write_file

    sources = sorted(examples.FOLDER.glob("*/*.toml"))
    copies = {source: folder / source.relative_to(examples.FOLDER) for source in sources}
    try:
        for copy in copies.values():
            if os.path.lexists(copy):
                raise UserError(f"{copy}: exists, and nothing is overwritten; choose another folder")
        for source, copy in copies.items():
            copy.parent.mkdir(parents=True, exist_ok=True)
            write_file(copy, source.read_bytes())
    except OSError as error:
        raise unusable(folder, "cannot be written", error, "choose another folder") from None
    copied = list(copies.values())
    answer(as_json, {"files": [str(path) for path in copied]}, lambda: print("\n".join(map(str, copied))))


def main() -> None:
    """Run the command. An error of the user's is one line on standard error, with its status: 2, or 1 for a damaged journal.

    Any other error is one line too, with status 1. The process is this program: its signals, hooks and streams are set here.
    """
    logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())  # its errors are raised as exceptions too
    sys.excepthook = lambda _kind, error, _trace: print_error(unexpected_error(error))  # of the window's slots
    threading.excepthook = lambda fault: print_error(unexpected_error(fault.exc_value or fault.exc_type()))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a letter that a terminal does not have must not break off a command
            with contextlib.suppress(OSError):  # of what is written before it: reported below
                stream.reconfigure(errors="backslashreplace")
    interrupt_on_end_signal()  # a stop in order: axes at rest, journal closed
    status = run_command()
    try:
        sys.stdout.flush()
    except OSError as error:  # a closed pipe, a full disk
        if not status and (full := _full_disk(error)):
            print_error(full)
        status = status or FAULT
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python repeats it at its end
    atexit.register(ignore_end_signals)  # the status is that of the command, which has ended
    sys.exit(status)


def usage_message(error: TyperException) -> str:
    """The message for arguments that typer refuses, with the help of the command they were given to."""
    text = error.format_message().replace("Value error, ", "").removesuffix(".")
    parameter: Any = getattr(error, "param", None)
    if text.startswith("Missing ") and (meaning := getattr(parameter, "help", "")):
        text += f": {meaning.removesuffix('.')}"
    if getattr(parameter, "multiple", False):
        text += f"; for several values repeat the option: {parameter.opts[0]} A {parameter.opts[0]} B"
    words, context = ["--help"], getattr(error, "ctx", None)
    while context is not None and context.parent is not None:
        words, context = [context.info_name, *words], context.parent
    return f"{text}{'' if text.endswith('?') else '.'} See: goniotwin {' '.join(words)}"


def run_command() -> int:
    """The exit status of the command."""
    try:
        return int(app(standalone_mode=False) or 0)
    except (KeyboardInterrupt, typer.Abort) as error:
        # typer takes the end of a file for Ctrl-C
        if isinstance(error.__cause__, EOFError) and (damaged := compilation.drop_damaged_code(error.__cause__)):
            print_error(damaged)
            return FAULT
        print_error("stopped")
        return INTERRUPTED
    except TyperException as error:
        print_error(usage_message(error))
        return 2
    except UserError as error:
        print_error(error)
        return error.status
    except BrokenPipeError:  # such as of `goniotwin ... | head`: the reader has what it wants
        return FAULT
    except Exception as error:  # noqa: BLE001  (last resort)
        if end_signal_received() and compilation.is_of_kept_code(error):  # Ctrl-C while numba was called by its compiler
            print_error("stopped")
            return INTERRUPTED
        if isinstance(error, OSError) and (fault := fault_of_named_path(error, sys.argv[1:])):
            print_error(fault)
            return UserError.status
        print_error(_full_disk(error) or compilation.drop_damaged_code(error) or unexpected_error(error))
        return FAULT


def _full_disk(error: Exception) -> str:
    """The message where a file or the output cannot be written because the disk is full, else empty."""
    if not isinstance(error, OSError) or not (remedy := room_on_disk(error)):
        return ""
    return f"{error.filename or 'standard output'}: {error.strerror}; {remedy}"


@app.command()
def schema(
    kind: Annotated[
        Literal["rig", "schedule", "tolerances"],
        typer.Argument(metavar="rig|schedule|tolerances", help="Kind of file.", show_default=False),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="Write the schema to this file, instead of printing it.", show_default=False
        ),
    ] = None,
) -> None:
    """Print JSON Schema of rigs, schedules or studies.

    With the schema, an editor completes and checks such files. Name it in the first line of a file:
    `#:schema ./rig.schema.json`.
    """
    from goniotwin.app.cli.work.schema import write_schema

    write_schema(kind, out)
