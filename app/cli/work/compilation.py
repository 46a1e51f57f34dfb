"""The compilation ahead of a first use.

numba compiles a kernel when it is first called, and keeps it in files (`twin.optics.kernel`). A *part* here calls some
functions of the product, once and as small as can be, so that their kernels exist before they are needed: before a progress
bar, and before several processes that would each compile them. A file beside the compiled code marks a part that is done. What
is missing all the same is compiled when it is called, and every command states that (`app.cli.compilation`).
"""

import contextlib
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from goniotwin.app.cli.compilation import drop_damaged_code
from goniotwin.app.cli.output import answer
from goniotwin.app.errors import UserError
from goniotwin.twin.optics import kernel
from goniotwin.twin.optics.bsdf.kinds import GAUSSIAN, LAMBERTIAN

if TYPE_CHECKING:  # compilation needs no rig and no schedule
    from goniotwin.app.campaign.schedule.file import ScheduleFile
    from goniotwin.twin.plant.model import TwinModel


class Part(NamedTuple):
    """Kernels that are needed together, and what calls them."""

    title: str
    call: Callable[[], object]


def _part(title: str, name: str) -> Part:
    return Part(title, partial(_call, name))


def _call(name: str) -> None:
    # Loads 320 modules more, pymodbus among them: 0.6 s, which a command does without where all is compiled.
    from goniotwin.app.cli.work import compiled_parts

    getattr(compiled_parts, name)()


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


def parts_of_rehearsal(schedule: "ScheduleFile", model: "TwinModel | None") -> tuple[str, ...]:
    """Names of the parts to compile for a rehearsal of the schedule on the virtual rig `model`, if there is one."""
    samples = () if model is None else [model.samples.get(name) for name in schedule.mounted]
    lobes = [lobe for each in samples if each is not None for lobe in each.lobes]
    through = bool(schedule.open_beam or schedule.signature)  # no sample: all light goes straight on
    plain = all(lobe.kind in (GAUSSIAN, LAMBERTIAN) for lobe in lobes) and not through
    return REHEARSAL if plain else (*REHEARSAL, "every-scene")


def compile_all(as_json: bool) -> None:
    """Compile every part. Raises UserError where compiled code cannot be kept."""
    missing, folder = compile_ahead(PARTS), kernel.FOLDER
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
    folder = kernel.FOLDER
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


def _compile(names: Iterable[str]) -> None:
    folder = kernel.FOLDER
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
    code = "import sys; from goniotwin.app.cli.work import compilation; compilation.compile_for_another(*sys.argv[1:])"
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
