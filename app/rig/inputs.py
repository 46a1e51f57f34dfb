"""The uncertain inputs of a rig, each declared once.

From its declaration follow the key of `[uncertainty]`, that of `[twin.disturbances]` and what is drawn by it, the input
quantities of a budget, and its row in docs/physics/inputs.md. One that is a factor on the light of sample or etalon needs
nothing else. The defaults are those of an ordinary laboratory that has aligned its instrument once, and are assumed.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le

from goniotwin.keys import Fraction
from goniotwin.twin.optics import Deviation
from goniotwin.twin.plant import disturbances as twin
from goniotwin.twin.plant.disturbances import ANGLE, ETALON, SAMPLE, SECOND, SharedBy, Target

Names = Mapping[str, tuple[Target, ...]]
"""Targets in the virtual rig, by the names of input quantities."""
Distribution = Literal["rectangular", "normal"]
UNIT = re.compile(r"_(deg|mm|nm|per_\w+)$")
"""The end of a key with a unit; a relative one may have none."""
LARGEST = {"deg": 5.0, "mm": 10.0, "nm": 50.0}
_declared: dict[str, "Input"] = {}


@contextmanager
def inputs_of_block() -> Iterator[None]:
    """Inputs that are declared within the block are there until its end."""
    before = dict(_declared)
    try:
        yield
    finally:
        _declared.clear()
        _declared.update(before)


@dataclass(frozen=True, eq=False)
class Input:
    """An uncertain input of the rig, described by `text`: to make one is to declare it.

    The default `u` is the half width of a rectangular distribution where the `key` ends with deg or mm, else a standard
    uncertainty; None where the key is one of the virtual rig alone, for u is stated elsewhere. `disturbs` has the targets in
    the virtual rig, by quantity, or those of the only one: it is called as the key without its unit, if no `name` is given.
    Raises ValueError for a second one of a key or of a quantity, and for a factor on the light of one photodiode, axis or scan.
    """

    key: str
    u: float | None
    text: str
    disturbs: Names | tuple[Target, ...] = ()
    shared_by: SharedBy = SharedBy.ALL
    name: str = ""
    largest: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.name or UNIT.sub("", self.key))
        if self.paths and self.shared_by not in (SharedBy.ALL, SharedBy.MOUNTING, SharedBy.MOVE):
            raise ValueError(f"{self.key}: a factor on the light is one for all values, for a mounting, or until the next move")
        for each in _declared.values():
            if self.key == each.key or {self.name, *self.targets} & {each.name, *each.targets}:
                raise ValueError(f"{self.key}: there is an input {each.key!r} of that key or quantity already")
        _declared[self.key] = self

    @cached_property
    def unit(self) -> str:
        """The unit of u; 1 for a relative one."""
        return next((unit for unit in LARGEST if self.key.endswith(f"_{unit}")), "1")

    @property
    def distribution(self) -> Distribution:
        """The distribution of the input's values."""
        return "rectangular" if self.unit in ("deg", "mm") else "normal"

    @property
    def bounds(self) -> Any:
        """The type of the key, with its bounds."""
        largest = self.largest or LARGEST.get(self.unit)
        return Fraction if largest is None else Annotated[float, Ge(0.0), Le(largest)]

    @property
    def per_year(self) -> bool:
        """Whether it counts once for each year since the etalon's calibration."""
        return self.key.endswith("_per_year")

    @cached_property
    def targets(self) -> Names:
        """What each of its quantities is added to in the virtual rig; empty for an input that this has by its geometry."""
        return self.disturbs if isinstance(self.disturbs, Mapping) else {self.name: self.disturbs} if self.disturbs else {}

    @cached_property
    def paths(self) -> frozenset[str]:
        """The paths on whose light it is a factor: SAMPLE, ETALON, SECOND, or several; empty for other inputs."""
        return frozenset(path for path, light in twin.LIGHT.items() if any(light in each for each in self.targets.values()))


def inputs() -> tuple[Input, ...]:
    """All declared inputs, in their order."""
    return tuple(_declared.values())


def factors(path: str = "") -> list[Input]:
    """The inputs of `[uncertainty]` that are factors on the light of a path, or of any."""
    return [each for each in inputs() if (path in each.paths if path else each.paths) and each.u is not None]


def input_named(name: str) -> Input:
    """The input of a quantity such as `mirror_2_tilt_x`, without mounting or number."""
    return next(each for each in inputs() if name in each.targets)


def pose_names() -> frozenset[str]:
    """The names of quantities of the whole rig that are a tilt or a shift of an element, or an axis' zero."""
    of_rig = [each for each in inputs() if each.shared_by is SharedBy.ALL and each.unit in ("deg", "mm")]
    return frozenset(name for each in of_rig for name in each.targets)


def element_deviations(values: Mapping[str, float], pupil_distance_mm: float) -> dict[str, Deviation]:
    """The deviations of the instrument's elements by the values of quantities, such as `mirror_2_tilt_x`."""
    amounts: dict[Target, float] = {}
    for name, targets in ((name, targets) for each in inputs() for name, targets in each.targets.items() if name in values):
        amounts |= {target: amounts.get(target, 0.0) + values[name] for target in targets}
    return twin.element_deviations(amounts, pupil_distance_mm)


def factor_of(*paths: str) -> tuple[Target, ...]:
    """The light of the SAMPLE, of the ETALON, or of both, with one and the same factor; also that of the SECOND standard."""
    return tuple(twin.LIGHT[path] for path in paths)


def tilts_of(*elements: str, axes: str = "xy") -> Names:
    """Tilts of elements about each of some axes."""
    return {f"{each}_tilt_{axis}": (Target(each, f"r{axis}_deg"),) for each in elements for axis in axes}


def shifts_of(*elements: str, part: str = "") -> Names:
    """Shifts of elements along each axis; `part` is the element in the virtual rig where it has another name."""
    return {f"{each}_shift_{axis}": (Target(part or each, f"{axis}_mm"),) for each in elements for axis in "xyz"}


MIRRORS = ("mirror_1", "mirror_2", "mirror_3")
FRAME = "about x and y of the frame that turns with gamma"
SAMPLE_TILT = Input("sample_tilt_deg", 0.05, f"tilt of a sample, {FRAME}", tilts_of(SAMPLE), SharedBy.MOUNTING)
SAMPLE_HEIGHT = Input(
    "sample_height_mm", 0.1, "lift of a sample along its normal", (Target(SAMPLE, "z_mm"),), SharedBy.MOUNTING
)
ETALON_TILT = Input("etalon_tilt_deg", 0.05, f"tilt of the etalon, {FRAME}", tilts_of(ETALON), SharedBy.MOUNTING)
ETALON_HEIGHT = Input(
    "etalon_height_mm", 0.1, "lift of the etalon along its normal", (Target(ETALON, "z_mm"),), SharedBy.MOUNTING
)
MIRROR_TILT = Input("mirror_tilt_deg", 0.05, "tilt of each mirror, about x and y along its sides", tilts_of(*MIRRORS))
MIRROR_SHIFT = Input("mirror_shift_mm", 0.1, "shift of each mirror along x, y, and z, its normal", shifts_of(*MIRRORS))
ILLUMINATION_SHIFT = Input(
    "illumination_shift_mm", 0.1, "shift of the exit pupil along the rig's axes", shifts_of("illumination", part="pupil")
)
ARC_TILT = Input("arc_tilt_deg", 0.05, "tilt of the arc about the rig's axes", tilts_of("arc", axes="xyz"))
ARC_SHIFT = Input("arc_shift_mm", 0.1, "shift of the arc along the rig's axes", shifts_of("arc"))
SENSOR_TILT = Input(
    "sensor_tilt_deg",
    0.05,
    "tilt of all photodiodes alike, each about its own x, along its arc, and its y, across it",
    tilts_of("sensor"),
)
SENSOR_SHIFT = Input(
    "sensor_shift_mm", 0.1, "shift of all photodiodes alike, each along its own x, y, and z, its view", shifts_of("sensor")
)
SIGMA_ZERO, BETA_ZERO, SHIFT_ZERO = (
    Input(
        f"{axis}_zero_deg",
        0.05,
        f"angle of {axis} minus the angle of its motor; switches and encoder do not show it",
        (ANGLE[axis],),
    )
    for axis in ("sigma", "beta", "shift")
)
PHOTODIODE_ANGLE = Input(
    "photodiode_angle_deg",
    0.05,
    "place of a photodiode on the arc, towards growing polar angle",
    (twin.ALONG,),
    SharedBy.PHOTODIODE,
)
PHOTODIODE_ACROSS = Input(
    "photodiode_across_deg",
    0.05,
    "place of a photodiode across the arc, towards growing beta",
    (twin.ACROSS,),
    SharedBy.PHOTODIODE,
)
POSITION = Input(
    "position_deg", 0.01, "error of the angle of an axis after a move, gamma too", tuple(ANGLE.values()), SharedBy.AXIS_MOVE
)
BACKLASH = Input(
    "backlash_deg",
    0.0,
    "play of an axis that the approach does not take up; not drawn: each axis of a virtual rig has this much more play",
    (twin.PLAY,),
    SharedBy.AXIS_MOVE,
)
FIELD_OF_VIEW = Input(
    "field_of_view",
    0.12,
    "logarithm of the variance of the directions; exit pupil and acceptance cone are scaled alike",
    (twin.FIELD,),
    name="field",
    largest=2.0,
)
WAVELENGTH = Input("wavelength_nm", 0.35, "true wavelength minus the set one", (twin.WAVELENGTH,))
LINEARITY = Input(
    "linearity_per_decade",
    1e-3,
    "change of the photodiodes' responsivity in a decade of current (above 1 nA)",
    (twin.LINEARITY,),
)
CROSSTALK = Input("crosstalk", 1e-5, "share of a channel's volts (12 at most) in the others of its module", (twin.CROSSTALK,))
MONITOR_LINEARITY = Input(
    "monitor_linearity_per_decade",
    1e-3,
    "change of the monitor's responsivity in a decade of current",
    (twin.MONITOR_LINEARITY,),
)
MONITOR_DRIFT = Input("monitor_drift_per_hour", 2e-4, "change of the monitor's responsivity in an hour", (twin.MONITOR_DRIFT,))
CERTIFICATE_LEVEL = Input(
    "certificate_level",
    None,
    "the etalon's radiance factor over its certificate's, less 1",
    factor_of(ETALON),
    name="certificate[level]",
)
ETALON_AGE = Input(
    "etalon_age_per_year",
    1e-3,
    "drift of the etalon in a year since its calibration; another one for a second standard",
    {"etalon_age": factor_of(ETALON), "second_age": factor_of(SECOND)},
    name="etalon_age",
)
ETALON_EDGE = Input(
    "etalon_edge",
    2e-3,
    "fraction of light that the etalon, a diffuser, loses at the edges of the frames; another one for a second standard",
    {"etalon_edge": factor_of(ETALON), "second_edge": factor_of(SECOND)},
)
MONOCHROMATOR_STRAY = Input(
    "monochromator_stray",
    1e-4,
    "light of all wavelengths, with the spectrum of the lamp, over the light at the set wavelength",
    (twin.STRAY_LIGHT,),
)
SCAN = Input("scan", 1e-3, "error of the sum of a scan of the open beam with steps of 0.2 deg", shared_by=SharedBy.SCAN)
BEAM_HOLE = Input("beam_hole", 4e-3, "fraction of the open beam that the hole of a frame cuts off, for each of the two frames")
REPEATABILITY = Input(
    "repeatability",
    0.0,
    "change of the signal of sample and etalon when a pose is reached again",
    factor_of(SAMPLE, ETALON),
    SharedBy.MOVE,
)
UNIFORMITY = Input(
    "uniformity",
    0.0,
    "change of the signal of sample and etalon with the place of the spot on the surface",
    factor_of(SAMPLE, ETALON),
    SharedBy.MOUNTING,
)
MOUNTING = Input(
    "mounting",
    0.0,
    "change of the signal of sample and etalon when they are mounted again",
    factor_of(SAMPLE, ETALON),
    SharedBy.MOUNTING,
)
HASHED = frozenset(inputs())
"""The inputs of the first hash of a model, which has all of them. A later one is in it where it is not 0: declare it below."""
BEAM_TILT = Input(
    "beam_tilt_deg",
    0.0,
    "tilt of the illumination unit about the sample's centre: the light turns, the slit's image stays",
    tilts_of("beam", axes="xz"),
)
SECOND_LEVEL = Input(
    "second_level",
    None,
    "the second standard's radiance factor over its certificate's, less 1",
    factor_of(SECOND),
    name="second_certificate[level]",
)
