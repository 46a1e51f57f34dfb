"""`goniotwin compile`, and the compilation before a first use: the optics' compiled code, made once, on two cores.

numba compiles a kernel when it is first called, and keeps it in files. A *part* here calls some kernels of the product, once
and as small as can be, so that they exist before they are needed; two processes share the parts. Whether a part is done is seen
in the files. What is missing all the same is compiled when it is called.
"""

import subprocess
import sys
from collections.abc import Callable, Collection
from dataclasses import dataclass
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

    What calls them, whether the files have them, and about how long it takes to compile them, s of one core.
    """

    title: str
    call: Callable[[], object]
    done: Callable[[], bool]
    seconds: float


def _scenes() -> None:
    from goniotwin.twin.optics import Instrument, gaussian, throughput

    throughput(Instrument(), 30.0, UPWARDS, gaussian(5.0))


def _every_scene() -> None:
    from goniotwin.twin.optics import Instrument, evaluate, light_direction, regular, throughput, ward

    throughput(Instrument(), 30.0, UPWARDS, regular(1.0))
    evaluate(ward(1.0, 0.1, 0.2), light_direction(30.0), UPWARDS)


def _rig() -> None:
    import numpy as np

    from goniotwin import examples
    from goniotwin.app.campaign.uncertainty.slopes import Directions, slopes_of
    from goniotwin.app.rig import read_rig
    from goniotwin.protocols.clock import VirtualClock
    from goniotwin.twin import VirtualRig
    from goniotwin.twin.optics import Instrument, evaluate, gaussian, light_direction, shadow_map
    from goniotwin.twin.optics.geometry.mirrors import mirrors_at
    from goniotwin.twin.plant.lamp import lamp_constants, lamp_mean

    shadow_map(Instrument(), 30.0, 45.0)
    mirrors_at(Instrument(), 30.0)
    evaluate(gaussian(5.0), light_direction(30.0), UPWARDS)
    model = read_rig(examples.RIG).model()
    assert model is not None
    plant = VirtualRig.build(model, VirtualClock()).plant  # on a real clock the light on the photodiodes would be computed
    plant.volts(0, 0.0)
    lamp_mean(0.0, plant.conversion_period_s, *lamp_constants(model.light, model.seed, model.noise))
    same, angles = np.zeros(5, dtype=np.int64), np.linspace(0.1, 0.2, 5)
    slopes_of(Directions(same, same, *[angles] * 6), angles, angles, 0.1)


def _forward() -> None:
    from goniotwin.twin.optics import Instrument, forward_throughput, gaussian

    forward_throughput(Instrument(), 30.0, UPWARDS, gaussian(5.0), 2)


def _illumination() -> None:
    from goniotwin.twin.optics import IlluminationUnit, adjoint_illumination, forward_illumination

    forward_illumination(IlluminationUnit(), rays=2)
    adjoint_illumination(IlluminationUnit(), rays=2)


def _has_scenes() -> bool:
    from goniotwin.twin.optics.fast.scenes import score_scenes
    from goniotwin.twin.optics.kernel import is_compiled

    return is_compiled(score_scenes, "none")


def _has_every_scene() -> bool:
    from goniotwin.twin.optics.fast.scenes import score_scenes
    from goniotwin.twin.optics.kernel import is_compiled

    return is_compiled(score_scenes, "bool")


def _has_rig() -> bool:
    from goniotwin.app.campaign.uncertainty.slopes import _fit
    from goniotwin.twin.optics.fast.obstruction import visible_shares
    from goniotwin.twin.optics.kernel import is_compiled
    from goniotwin.twin.plant.converter import convert_channels

    return is_compiled(visible_shares) and is_compiled(convert_channels) and is_compiled(_fit)


def _has_forward() -> bool:
    from goniotwin.twin.optics.forward.blocks import trace
    from goniotwin.twin.optics.kernel import is_compiled

    return is_compiled(trace)


def _has_illumination() -> bool:
    from goniotwin.twin.optics.illumination import adjoint, forward
    from goniotwin.twin.optics.kernel import is_compiled

    return is_compiled(forward._trace) and is_compiled(adjoint._trace)


UPWARDS = [[0.0, 0.0, 1.0]]
PARTS = {
    "scenes": Part("light on the detectors", _scenes, _has_scenes, 9.0),
    "rig": Part("shadows, electronics, uncertainties", _rig, _has_rig, 6.0),
    "every-scene": Part("light by every kind of sample", _every_scene, _has_every_scene, 13.0),
    "forward": Part("forward estimator", _forward, _has_forward, 12.0),
    "illumination": Part("illumination unit", _illumination, _has_illumination, 5.0),
}
REHEARSAL = ("scenes", "rig")
"""What every rehearsal needs; Gaussian and diffuse samples need no more."""


def parts_of_rehearsal(schedule: "ScheduleFile", model: "TwinModel | None") -> tuple[str, ...]:
    """Names of the parts that a rehearsal of the schedule needs on the virtual rig `model`, if there is one."""
    from goniotwin.twin.optics.fast.scenes import PLAIN_KINDS

    samples = () if model is None else [model.samples.get(name) for name in (schedule.etalon, *schedule.samples)]
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
    seconds = max(sum(PARTS[name].seconds for name in half) for half in (here, there))
    print_note(f"compiling the optics, once: {'; '.join(PARTS[name].title for name in missing)}; about {seconds:.0f} s")
    other = _start(there) if there else None
    try:
        _compile(here)
        if other is not None and (fault := _end_of(other)):
            raise UserError(f"the optics cannot be compiled: {fault}")
    finally:
        if other is not None and other.poll() is None:  # stopped: what is compiled is kept, the rest is for the next time
            other.kill()
            other.wait()
    return missing


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
