"""`goniotwin compile`, the compilation ahead of a first use, and the line that states it.

numba compiles a kernel when it is first called, and keeps it in files (`twin.optics.kernel`). A *part* here calls some
functions of the product, once and as small as can be, so that their kernels exist before they are needed: before a progress
bar, and before several processes that would each compile them. A file beside the compiled code marks a part that is done. What
is missing all the same is compiled when it is called, and every command states that.
"""

import contextlib
import logging
import shutil
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from goniotwin.app.cli.output import Json, answer, print_note
from goniotwin.app.end_signals import end_signal_received
from goniotwin.app.errors import UserError

if TYPE_CHECKING:
    from goniotwin.app.campaign.schedule.file import ScheduleFile
    from goniotwin.twin.plant.model import TwinModel

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


class Part(NamedTuple):
    """Kernels that are needed together, and what calls them."""

    title: str
    call: Callable[[], object]


def _part(title: str, name: str) -> Part:
    def call() -> None:
        # Loads 704 modules, numba and pymodbus among them: 0.9 s, which help does without.
        from goniotwin.app.cli import compiled_parts

        getattr(compiled_parts, name)()

    return Part(title, call)


PARTS = {
    "scenes": _part("light on the detectors", "scenes"),
    "rig": _part("samples, electronics", "rig"),
    "shadows": _part("shadows", "shadows"),
    "uncertainties": _part("uncertainties", "uncertainties"),
    "every-scene": _part("samples of every kind", "every_scene"),
    "forward": _part("forward estimator", "forward"),
    "illumination": _part("illumination unit", "illumination"),
    "sequences": _part("path search, measured points, tolerances", "sequences"),
}
REHEARSAL = ("scenes", "rig", "uncertainties")
"""What every rehearsal needs; Gaussian and diffuse samples need no more."""
LOG = logging.getLogger("goniotwin.compilation")
NOTE = "compiling the optics, once with this version: about a minute for a rehearsal"
FIRST_LOOK_S, LAST_LOOK_S = 0.2, 60.0
NUMBAS_CACHE = ("numba", "core", "caching.py")
NOT_KEPT = "compiling the optics, for this command alone: code can be kept nowhere; set NUMBA_CACHE_DIR to a folder of yours"


def parts_of_rehearsal(schedule: "ScheduleFile", model: "TwinModel | None") -> tuple[str, ...]:
    """Names of the parts that a rehearsal of the schedule needs on the virtual rig `model`, if there is one."""
    # Loads 4 modules: 3 ms, which help does without.
    from goniotwin.twin.optics.bsdf.kinds import GAUSSIAN, LAMBERTIAN

    samples = () if model is None else [model.samples.get(name) for name in schedule.mounted]
    lobes = [lobe for each in samples if each is not None for lobe in each.lobes]
    through = bool(schedule.open_beam or schedule.signature)  # no sample: all light goes straight on
    plain = all(lobe.kind in (GAUSSIAN, LAMBERTIAN) for lobe in lobes) and not through
    return REHEARSAL if plain else (*REHEARSAL, "every-scene")


@app.command("compile")
def compile_optics(as_json: Json = False) -> None:
    """Compile the optics once, ahead of the first use.

    Otherwise that takes place in the first command that needs it. The code is kept in files for this computer and this version
    of the program; results are the same.
    """
    missing, folder = compile_ahead(PARTS), _folder()
    answer(
        as_json,
        {"compiled": missing, "folder": str(folder)},
        lambda: print(
            f"compiled in {folder}: {'; '.join(PARTS[name].title for name in missing)}"
            if missing
            else f"nothing to do: all is compiled, in {folder}"
        ),
    )


def compile_ahead(names: Collection[str] = REHEARSAL) -> list[str]:
    """Compile the parts `names` that are not marked as done, and mark them: every second one in another process.

    Returns their names. Raises UserError where one cannot be compiled, or `names` are all and compiled code cannot be kept.
    """
    folder = _folder()
    if folder is None:
        if names is PARTS:
            raise UserError("no folder for compiled code can be used: set NUMBA_CACHE_DIR to one that is yours alone")
        return []
    try:
        missing = [name for name in names if not (folder / f"{name}.done").exists()]
    except OSError:  # of a process that has become another user's
        return []
    with compiling_elsewhere(missing[1::2]):
        _compile(missing[::2])
    return missing


def _folder() -> Path | None:
    """The folder of compiled code."""
    # Loads 384 modules, numba and numpy among them: 0.3 s, which help does without.
    from goniotwin.twin.optics.kernel import FOLDER

    return FOLDER


def _compile(names: Iterable[str]) -> None:
    folder = _folder()
    for name in names:
        PARTS[name].call()
        with contextlib.suppress(OSError):  # the next command looks again
            if folder is not None:
                (folder / f"{name}.done").touch()


def compile_for_another(*names: str) -> None:
    """Compile parts in a process of their own. Exits with the reason where code was damaged, which is dropped."""
    try:
        _compile(names)
    except Exception as error:
        if damaged := drop_damaged_code(error):
            sys.exit(damaged)
        raise


@contextlib.contextmanager
def compiling_elsewhere(names: Collection[str]) -> Iterator[None]:
    """Have another process compile parts meanwhile; at the end it has, or it is ended. Raises UserError where it cannot."""
    if not names:
        yield
        return
    code = "import sys; from goniotwin.app.cli import compilation; compilation.compile_for_another(*sys.argv[1:])"
    with subprocess.Popen(
        [sys.executable, "-c", code, *names],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as other:
        try:
            yield
            _, errors = other.communicate()
        finally:
            other.kill()  # if it compiles still: what is compiled is kept
    if other.returncode:
        raise UserError(f"the optics cannot be compiled: {(errors.strip().splitlines() or ['the process ended'])[-1]}")


class CompilationNotes(logging.Handler):
    """States that kernels are compiled, once there is a new file of compiled code. Looks for one from the first kernel on."""

    def __init__(self, first_look_s: float) -> None:
        super().__init__(logging.INFO)
        self._first_look_s = first_look_s
        self._ended = threading.Event()
        self._watch: threading.Thread | None = None

    def emit(self, _record: logging.LogRecord) -> None:
        """Begin to look: kernels are about to be defined, by the record of `twin.optics.kernel` (logging calls this)."""
        folder = _folder()
        if folder is None:
            print_note(NOT_KEPT)
            self._ended.set()
        elif self._watch is None:
            self._watch = threading.Thread(target=self._look, args=(folder, _files(folder)), name="compiled code", daemon=True)
            self._watch.start()

    def _look(self, folder: Path, known: int) -> None:
        pause_s = self._first_look_s
        while not self._ended.wait(pause_s):
            if _files(folder) > known:
                print_note(NOTE)
                return
            pause_s = min(1.1 * pause_s, LAST_LOOK_S)  # a campaign may take a day, and compiles at its start

    def close(self) -> None:
        """State nothing more."""
        LOG.removeHandler(self)
        self._ended.set()
        if self._watch is not None:
            self._watch.join()
        super().close()


def _files(folder: Path) -> int:
    """Number of kernels whose code is in a folder; 0 where it cannot be read."""
    with contextlib.suppress(OSError):
        return sum(1 for _ in folder.glob("*/*.nbi"))
    return 0


def state_compilation(first_look_s: float = FIRST_LOOK_S) -> None:
    """Have a command state that it compiles, where it does; the first look is after `first_look_s`, the others ever later."""
    state_no_more()
    LOG.addHandler(CompilationNotes(first_look_s))
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
    if "goniotwin.twin.optics.kernel" in sys.modules:
        LOG.info("kernels are defined")


def state_no_more() -> None:
    """Leave the compiler's log as it was before `state_compilation`, at the end of a command."""
    for each in [each for each in LOG.handlers if isinstance(each, CompilationNotes)]:
        each.close()
    LOG.setLevel(logging.NOTSET)
    LOG.propagate = True


def is_of_kept_code(error: BaseException) -> bool:
    """Whether an error is of numba's reading or writing of compiled code."""
    return any(Path(each.filename).parts[-3:] == NUMBAS_CACHE for each in traceback.extract_tb(error.__traceback__))


def drop_damaged_code(error: BaseException) -> str:
    """Drop compiled code that numba cannot read, as after a power failure; the message. Empty for another error.

    A program that is being ended breaks off what numba writes: then nothing is damaged.
    """
    kernel = sys.modules.get("goniotwin.twin.optics.kernel")
    folder = kernel.FOLDER if kernel is not None and is_of_kept_code(error) and not end_signal_received() else None
    if folder is None:
        return ""
    shutil.rmtree(folder, ignore_errors=True)
    return f"{folder}: compiled code was damaged, and is removed; repeat the command"
