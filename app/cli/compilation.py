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


def _scenes() -> None:
    from goniotwin.twin.optics import Instrument, gaussian, throughput

    throughput(Instrument(), 30.0, UPWARDS, gaussian(5.0))


def _every_scene() -> None:
    from goniotwin.twin.optics import albedo, evaluate, gaussian, light_direction, regular, ward

    evaluate(ward(1.0, 0.1, 0.2), light_direction(30.0), UPWARDS)
    albedo(regular(1.0), 30.0)
    albedo(gaussian(5.0, transmits=True, refraction=1.5), 30.0, transmitted=True)


def _rig() -> None:
    import numpy as np

    from goniotwin import examples
    from goniotwin.app.rig import read_rig
    from goniotwin.protocols.clock import VirtualClock
    from goniotwin.twin import VirtualRig
    from goniotwin.twin.optics import evaluate, gaussian, light_direction
    from goniotwin.twin.plant.lamp import lamp_constants, lamp_mean
    from goniotwin.twin.plant.noise import mix
    from goniotwin.twin.plant.process_key import process_key

    evaluate(gaussian(5.0), light_direction(30.0), UPWARDS)
    model = read_rig(examples.RIG).model()
    assert model is not None
    plant = VirtualRig.build(model, VirtualClock()).plant  # on a real clock the light on the photodiodes would be computed
    plant.volts(0, 0.0)
    plant.coming_readings(1000)
    lamp_mean(0.0, plant.conversion_period_s, *lamp_constants(model.light, model.seed, model.noise))
    mix(process_key(model.seed, "encoder"), np.int64(0))


def _shadows() -> None:
    from goniotwin.twin.optics import Instrument, shadow_map
    from goniotwin.twin.optics.geometry.mirrors import mirrors_at

    shadow_map(Instrument(), 30.0, 45.0)
    mirrors_at(Instrument(), 30.0)


def _uncertainties() -> None:
    import numpy as np

    from goniotwin.app.campaign.measurement_model.lit_share import LitEnsemble, LitModes
    from goniotwin.app.campaign.measurement_model.slopes import Directions, slopes_of

    same, angles = np.zeros(5, dtype=np.int64), np.linspace(0.1, 0.2, 5)
    slopes_of(Directions(same, same, same, *[angles] * 6), angles, angles, 0.1)
    one = np.ones((1, 1))
    LitModes(LitEnsemble(one, one, one, one[0]), one).quantiles(one, one[0], (0.1, 0.9))


def _forward() -> None:
    import numpy as np

    from goniotwin.twin.optics import (
        Instrument,
        RealSensor,
        draw_directions,
        forward_throughput,
        gaussian,
        light_direction,
    )
    from goniotwin.twin.optics.forward.stray_light import stray_map

    for instrument in (Instrument(), Instrument(sensor=RealSensor())):
        forward_throughput(instrument, 30.0, UPWARDS, gaussian(5.0), 2)
    stray_map(Instrument(), 30.0, gaussian(5.0), 2)
    draw_directions(gaussian(5.0), light_direction(30.0), np.full((1, 4), 0.5))


def _illumination() -> None:
    import numpy as np

    from goniotwin.twin.optics import (
        IlluminationUnit,
        Instrument,
        adjoint_illumination,
        field_fluxes,
        forward_illumination,
        pupil_image,
        record,
    )
    from goniotwin.twin.optics.geometry.scene import scene_at
    from goniotwin.twin.optics.illumination.slit_image import lit_corners

    forward_illumination(IlluminationUnit(), rays=2)
    adjoint_illumination(IlluminationUnit(), rays=2)
    field_fluxes(IlluminationUnit(), np.zeros((1, 6, 6)))
    record(IlluminationUnit(), rays=2, seed=1)
    pupil_image(Instrument(), 30.0)
    lit_corners(Instrument(), scene_at(Instrument(), 30.0))


def _sequences() -> None:
    import numpy as np

    from goniotwin.app.campaign.planning.path_search import shorten_path
    from goniotwin.twin.optics.bsdf.point_samples import plane_through_points
    from goniotwin.twin.optics.fast.surrogate import fill_relative_rms

    shorten_path(np.arange(3), np.ones((4, 4)), 10)
    plane_through_points(np.array(UPWARDS), np.array(UPWARDS), np.ones(1), 1.0)
    fill_relative_rms(np.zeros((1, 1)), np.zeros((3, 4)), np.zeros((4, 1)), np.empty(1))


UPWARDS = [[0.0, 0.0, 1.0]]
PARTS = {
    "scenes": Part("light on the detectors", _scenes),
    "rig": Part("samples, electronics", _rig),
    "shadows": Part("shadows", _shadows),
    "uncertainties": Part("uncertainties", _uncertainties),
    "every-scene": Part("samples of every kind", _every_scene),
    "forward": Part("forward estimator", _forward),
    "illumination": Part("illumination unit", _illumination),
    "sequences": Part("path search, measured points, tolerances", _sequences),
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
    from goniotwin.twin.optics.kernel import FOLDER

    missing = compile_ahead(PARTS)
    answer(
        as_json,
        {"compiled": missing, "folder": str(FOLDER)},
        lambda: print(
            f"compiled in {FOLDER}: {'; '.join(PARTS[name].title for name in missing)}"
            if missing
            else f"nothing to do: all is compiled, in {FOLDER}"
        ),
    )


def compile_ahead(names: Collection[str] = REHEARSAL) -> list[str]:
    """Compile the parts `names` that are not marked as done, and mark them: every second one in another process.

    Returns their names. Raises UserError where one cannot be compiled, or `names` are all and compiled code cannot be kept.
    """
    from goniotwin.twin.optics.kernel import FOLDER

    if FOLDER is None:
        if names is PARTS:
            raise UserError("no folder for compiled code can be used: set NUMBA_CACHE_DIR to one that is yours alone")
        return []
    try:
        missing = [name for name in names if not (FOLDER / f"{name}.done").exists()]
    except OSError:  # of a process that has become another user's
        return []
    with compiling_elsewhere(missing[1::2]):
        _compile(missing[::2])
    return missing


def _compile(names: Iterable[str]) -> None:
    from goniotwin.twin.optics.kernel import FOLDER

    for name in names:
        PARTS[name].call()
        with contextlib.suppress(OSError):  # the next command looks again
            if FOLDER is not None:
                (FOLDER / f"{name}.done").touch()


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
        from goniotwin.twin.optics.kernel import FOLDER

        if FOLDER is None:
            print_note(NOT_KEPT)
            self._ended.set()
        elif self._watch is None:
            self._watch = threading.Thread(target=self._look, args=(FOLDER, _files(FOLDER)), name="compiled code", daemon=True)
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
