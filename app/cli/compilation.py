"""`goniotwin compile`, and the compilation before a first use: the optics' compiled code, made once, on two cores.

numba compiles a kernel when it is first called, and keeps it in files. A *part* here calls some kernels of the product, once
and as small as can be, so that they exist before they are needed; two processes share the parts. Whether a part is done is seen
in the files. What is missing all the same is compiled when it is called: `state_compilation` has every command state that, and
has another process compile the rest of what the command needs meanwhile.
"""

import logging
import subprocess
import sys
from collections.abc import Callable, Collection
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import typer

from goniotwin.app.cli.output import Json, answer, print_note
from goniotwin.app.errors import UserError

if TYPE_CHECKING:
    from goniotwin.app.campaign.schedule.file import ScheduleFile
    from goniotwin.twin.plant.model import TwinModel

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@dataclass(frozen=True)
class Part:
    """Kernels that are needed together.

    What calls them; their names in `goniotwin`, some with the type of their last argument behind a space; and about how long it
    takes to compile them, s of one core.
    """

    title: str
    call: Callable[[], object]
    kernels: tuple[str, ...]
    seconds: float

    def done(self) -> bool:
        """Whether the files have all of them."""
        from goniotwin.twin.optics.kernel import is_compiled

        for name, _, last in (each.partition(" ") for each in self.kernels):
            module, _, function = name.rpartition(".")
            if not is_compiled(getattr(import_module(f"goniotwin.{module}"), function), last):
                return False
        return True


def _scenes() -> None:
    from goniotwin.twin.optics import Instrument, gaussian, throughput

    throughput(Instrument(), 30.0, UPWARDS, gaussian(5.0))


def _every_scene() -> None:
    from goniotwin.twin.optics import Instrument, albedo, evaluate, gaussian, light_direction, regular, throughput, ward

    throughput(Instrument(), 30.0, UPWARDS, regular(1.0))
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
    from goniotwin.twin.plant.noise import mix, process_key

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

    from goniotwin.twin.optics import Instrument, draw_directions, forward_throughput, gaussian, light_direction
    from goniotwin.twin.optics.forward.stray_light import stray_map

    forward_throughput(Instrument(), 30.0, UPWARDS, gaussian(5.0), 2)
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
OPTICS, PLANT = "twin.optics", "twin.plant"
PARTS = {
    "scenes": Part(
        "light on the detectors",
        _scenes,
        (f"{OPTICS}.fast.scenes.score_scenes none",),
        9.0,
    ),
    "rig": Part(
        "samples, electronics",
        _rig,
        (
            f"{OPTICS}.bsdf.models.evaluate_all",
            *(f"{PLANT}.converter.{each}" for each in ("conversions", "convert_channels", "convert_readings")),
            f"{PLANT}.lamp.lamp_mean",
            *(f"{PLANT}.noise.{each}" for each in ("normal", "mix")),
        ),
        2.5,
    ),
    "shadows": Part(
        "shadows",
        _shadows,
        (
            f"{OPTICS}.fast.obstruction.visible_shares",
            *(f"{OPTICS}.geometry.scene.{each}" for each in ("empty_scene", "fill_scene", "fill_detectors")),
            f"{OPTICS}.geometry.mirrors.fill_mirrors",
        ),
        3.5,
    ),
    "uncertainties": Part(
        "uncertainties",
        _uncertainties,
        (
            *(f"app.campaign.measurement_model.slopes.{each}" for each in ("_fit", "_fit_over_theta", "_mix")),
            "app.campaign.measurement_model.lit_share._find_quantiles",
        ),
        1.0,
    ),
    "every-scene": Part(
        "light by every kind of sample",
        _every_scene,
        (f"{OPTICS}.fast.scenes.score_scenes bool", *(f"{OPTICS}.bsdf.models.{each}" for each in ("refract", "regular_share"))),
        13.0,
    ),
    "forward": Part(
        "forward estimator",
        _forward,
        (
            f"{OPTICS}.forward.blocks.trace",
            f"{OPTICS}.forward.scoring._fill_lists",
            f"{OPTICS}.forward.spread.projected_solid_angles",
            f"{OPTICS}.bsdf.packed_lobes.lobe_share",
            f"{OPTICS}.bsdf.sampling.scatter_all",
            f"{OPTICS}.bsdf.models.to_canonical",
            f"{OPTICS}.geometry.scene.mirror_angle_deg",
        ),
        12.0,
    ),
    "illumination": Part(
        "illumination unit",
        _illumination,
        (
            f"{OPTICS}.illumination.forward._trace",
            f"{OPTICS}.illumination.adjoint._trace",
            f"{OPTICS}.illumination.field_flux._fill_fluxes",
            f"{OPTICS}.illumination.rayset._record",
            f"{OPTICS}.geometry.deviation.rotations",
            *(f"{OPTICS}.illumination.slit_image.{each}" for each in ("empty_image", "place_slit", "_lit_polygon")),
            *(f"{OPTICS}.geometry.mirrors.{each}" for each in ("place_unit", "reflect_rows")),
        ),
        8.0,
    ),
    "sequences": Part(
        "path search, measured points, tolerances",
        _sequences,
        (
            "app.campaign.planning.path_search._shorten",
            f"{OPTICS}.bsdf.point_samples.plane_through_points",
            f"{OPTICS}.fast.surrogate.fill_relative_rms",
        ),
        2.0,
    ),
}
REHEARSAL = ("scenes", "rig", "uncertainties")
"""What every rehearsal needs; Gaussian and diffuse samples need no more."""
VIRTUAL_RIG = (*REHEARSAL, "every-scene")
"""What the devices of a virtual rig need: without a sample all light goes straight on."""
NEEDS = {
    **dict.fromkeys(("run", "serve", "station", "move", "read", "usb", "replay", "desktop"), VIRTUAL_RIG),
    **dict.fromkeys(("demo", "rehearse", "prove"), REHEARSAL),
    "simulate": ("scenes", "shadows", "forward"),
    "tolerances": ("scenes", "sequences"),
    "render": ("scenes", "shadows"),
}
"""What commands need of the parts. Any other command states what it compiles, one part after the other."""
LOG = logging.getLogger("goniotwin.compilation")


def parts_of_rehearsal(schedule: "ScheduleFile", model: "TwinModel | None") -> tuple[str, ...]:
    """Names of the parts that a rehearsal of the schedule needs on the virtual rig `model`, if there is one."""
    from goniotwin.twin.optics.fast.scenes import PLAIN_KINDS

    samples = () if model is None else [model.samples.get(name) for name in schedule.mounted]
    lobes = [lobe for each in samples if each is not None for lobe in each.lobes]
    through = bool(schedule.open_beam or schedule.signature)  # no sample: all light goes straight on
    return (*REHEARSAL, "every-scene") if through or any(lobe.kind not in PLAIN_KINDS for lobe in lobes) else REHEARSAL


@app.command("compile")
def compile_optics(as_json: Json = False) -> None:
    """Compile the optics once, ahead of the first use.

    Otherwise that takes place in the first command that needs it. The code is kept in files for this computer and this version
    of the program; results are the same.
    """
    from goniotwin.twin.optics.kernel import cache_folder

    missing, folder = compile_ahead(PARTS), cache_folder()
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
    """Compile the parts `names` that are missing, in two processes. Returns their names.

    Raises UserError where compiled code cannot be kept, or a part cannot be compiled.
    """
    from goniotwin.twin.optics.kernel import cache_folder

    if cache_folder() is None:
        if names is PARTS:
            raise UserError("no folder for compiled code can be written: set NUMBA_CACHE_DIR to one that can")
        return []
    missing = [name for name in names if not PARTS[name].done()]
    if not missing:
        return []
    here, there = _halves(missing)
    _state(missing, here, there)
    other = _start(there) if there else None
    stated, LOG.disabled = LOG.disabled, True
    try:
        _compile(here)
        if other is not None and (fault := _end_of(other)):
            raise UserError(f"the optics cannot be compiled: {fault}")
    finally:
        LOG.disabled = stated
        _kill(other)
    return missing


class CompilationNotes(logging.Handler):
    """States that kernels are compiled when a first one is, and has another process compile what else `names` lack.

    A kernel of which the other process has the part is waited for, and then comes from the files. Kernels come as log
    records by `twin.optics.kernel`, in the thread that needs them.
    """

    def __init__(self, names: Collection[str]) -> None:
        super().__init__(logging.INFO)
        self._names = names
        self._stated = False
        self._there: list[str] = []
        self._other: subprocess.Popen[str] | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Take the record of a kernel that is about to be compiled (logging calls this)."""
        kernel = record.getMessage()
        part = next((name for name, each in PARTS.items() if any(f"{kernel} ".startswith(f"{k} ") for k in each.kernels)), None)
        if part in self._there and self._other is not None:
            _end_of(self._other)  # what it could not compile is compiled here, and gives its own error
        elif not self._stated:
            self._stated = True
            self._begin(part, kernel)

    def _begin(self, part: str | None, kernel: str) -> None:
        from goniotwin.twin.optics.kernel import cache_folder

        if cache_folder() is not None:
            self._there = [name for name in self._names if name != part and not PARTS[name].done()]
        here = [part] if part is not None else []
        _state([*here, *self._there], here, self._there, "" if part is not None else kernel)
        if self._there:
            self._other = _start(self._there)

    def close(self) -> None:
        """State nothing more, and end the other process."""
        LOG.removeHandler(self)
        _kill(self._other)
        super().close()


def state_compilation(command: str) -> None:
    """Have a command state that it compiles, where it does, and compile on both cores. Costs nothing where all is compiled."""
    state_no_more()
    LOG.addHandler(CompilationNotes(NEEDS.get(command, ())))
    LOG.setLevel(logging.INFO)
    LOG.propagate = False


def state_no_more() -> None:
    """Leave the compiler's log as it was before `state_compilation`, at the end of a command."""
    for each in [each for each in LOG.handlers if isinstance(each, CompilationNotes)]:
        each.close()
    LOG.setLevel(logging.NOTSET)
    LOG.propagate = True


def _state(names: Collection[str], here: Collection[str], there: Collection[str], kernel: str = "") -> None:
    seconds = max(sum(PARTS[name].seconds for name in half) for half in (here, there))
    titles = [*(PARTS[name].title for name in names), *([kernel] if kernel else [])]
    print_note(f"compiling the optics, once: {'; '.join(titles)}; about {max(seconds, 1.0):.0f} s")


def _halves(names: list[str]) -> tuple[list[str], list[str]]:
    """Parts for two processes, about as long: the longer half, then the other."""
    halves: tuple[list[str], list[str]] = ([], [])
    taken = [0.0, 0.0]
    for name in sorted(names, key=lambda each: -PARTS[each].seconds):
        which = int(taken[1] < taken[0])
        halves[which].append(name)
        taken[which] += PARTS[name].seconds
    return halves


def _compile(names: list[str]) -> None:
    for name in names:
        PARTS[name].call()


def _start(names: list[str]) -> "subprocess.Popen[str]":
    code = f"from goniotwin.app.cli import compilation; compilation._compile({names!r})"
    return subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


def _end_of(process: Any) -> str:
    """Wait for the process; the last line of its error, empty where all is well."""
    _, text = process.communicate()
    lines = text.strip().splitlines()
    return "" if process.returncode == 0 else (lines[-1] if lines else f"process ended with {process.returncode}")


def _kill(process: "subprocess.Popen[str] | None") -> None:
    """End the process if it compiles still: what is compiled is kept, the rest is for the next time."""
    if process is not None and process.poll() is None:
        process.kill()
        process.wait()
