"""Dimensions of the instrument: exit pupil, mirrors and their reflectance, the sample's frames, detectors."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from annotated_types import Ge, Gt, Le, Lt

from goniotwin.arrays import Floats
from goniotwin.keys import LATER, NonNegative, Positive, Share, check_bounds
from goniotwin.twin.optics.geometry.deviation import NO_DEVIATION, Deviation, check_deviations, rotation_and_shift
from goniotwin.twin.optics.geometry.sensor import RealSensor

NOMINAL_DEG = 45.0
"""Incidence of the beam's axis on each of the three mirrors."""
NOMINAL_NM = 555.0
MIRROR_REFLECTANCE = 0.95
ELEMENTS = ("pupil", "mirror_1", "mirror_2", "mirror_3", "mirror_unit", "sample", "arc", "sensor")
PUPIL, MIRROR_1, MIRROR_2, MIRROR_3, MIRROR_UNIT, SAMPLE, ARC, SENSOR = range(len(ELEMENTS))
"""Rows of an array of deviations."""
COMPONENTS = tuple(each.name for each in fields(Deviation))
"""Columns of an array of deviations: three angles, deg, and three shifts, mm."""
MIRROR_DISTANCE, PUPIL_TO_MIRROR, PUPIL_RADIUS, ARC_RADIUS, HALF_SPOT, HALF_MIRROR, HALF_BLOCKING = range(7)
"""Entries of `Instrument.lengths`."""
ILLUMINATION_ELEMENTS = ("arc", "reflector", "input_condenser", "slit", "output_condenser", "unit")
"""Elements of the illumination unit with deviations of their own; `unit` is all of them together."""
LEAST_GAP_MM = 1e-3


@dataclass(frozen=True, eq=False)
class Reflectance:
    """Reflectance of a mirror: values (w, a) in 0..1 over wavelengths (w,) in nm and incidences (a,) in deg.

    Both lists ascend. Linear interpolation; the first and last values hold outside the lists. A list of one entry means no
    dependence. Raises ValueError, naming the argument, for lists that do not ascend, a wrong shape, or values out of range.
    """

    wavelength_nm: Floats
    angle_deg: Floats
    values: Floats

    def __post_init__(self) -> None:
        lists = {}
        for name in ("wavelength_nm", "angle_deg", "values"):
            lists[name] = np.array(getattr(self, name), dtype=np.float64)
            lists[name].flags.writeable = False
            object.__setattr__(self, name, lists[name])
        for name, last in (("wavelength_nm", np.inf), ("angle_deg", 90.0)):
            axis = lists[name]
            if axis.ndim != 1 or not axis.size or not np.all(np.isfinite(axis)) or np.any(np.diff(axis) <= 0.0):
                raise ValueError(f"{name} is {axis.tolist()}: give an ascending list of finite numbers")
            if axis[0] < 0.0 or axis[-1] > last:
                raise ValueError(f"{name} runs from {axis[0]:g} to {axis[-1]:g}: keep it within 0 and {last:g}")
        shape = (lists["wavelength_nm"].size, lists["angle_deg"].size)
        if self.values.shape != shape:
            raise ValueError(f"values has the shape {self.values.shape}; with these wavelengths and angles give {shape}")
        if not np.all((self.values > 0.0) & (self.values <= 1.0)):
            raise ValueError("values has one that is not above 0 and at most 1: a mirror reflects a share of the light")

    def at(self, wavelength_nm: float | None, angle_deg: npt.ArrayLike) -> Floats:
        """Reflectance (...) at one wavelength and angles (...). Raises ValueError if the wavelength is needed and missing."""
        if self.wavelength_nm.size == 1:
            row = self.values[0]
        elif wavelength_nm is None:
            raise ValueError("wavelength_nm is missing: the mirrors' reflectance depends on it; give a wavelength")
        else:
            row = np.array([np.interp(wavelength_nm, self.wavelength_nm, column) for column in self.values.T])
        return np.asarray(np.interp(np.asarray(angle_deg, dtype=np.float64), self.angle_deg, row))


def reflected_share(reflectance: "float | Reflectance", wavelength_nm: float | None, angle_deg: npt.ArrayLike) -> Floats:
    """Reflectance (...) for unpolarised light at angles (...) of incidence, of a number or of a table.

    Raises ValueError for a table over the wavelength without a wavelength.
    """
    if isinstance(reflectance, Reflectance):
        return reflectance.at(wavelength_nm, angle_deg)
    return np.full(np.shape(angle_deg), float(reflectance))


def nominal_reflectance(reflectance: "float | Reflectance") -> float:
    """Reflectance at 45 deg and 555 nm."""
    return float(reflected_share(reflectance, NOMINAL_NM, NOMINAL_DEG))


@dataclass(frozen=True)
class Dimensions:
    """Dimensions in mm, angles in degrees (paper, sections 3.1 and 3.2), as an operator knows them. They decide which
    directions the mirror unit blocks, and over which directions a value is a mean.

    `pupil_radius_mm`: radius of the exit pupil, seen over the mirrors: half of the beam's divergence. The default gives 0.7
    deg, and is assumed. `mirror_distance_mm`: distance of a mirror to the next, and of the last one to the sample.
    `mirror_side_mm`: side of the square mirrors. `mirror_mount_mm`: width of the mirrors' black mounts beyond their edges, on
    all sides. `spot_side_mm`: side of the square spot that the beam makes on the sample. `arc_radius_mm`: radius of the arc
    with the detectors. `detector_diameter_mm`: diameter of a detector. `field_deg`: full width of a detector's acceptance cone,
    0.5 to 2.5 deg in the paper.

    Raises ValueError, naming the field, for a value out of range.
    """

    pupil_radius_mm: Positive = 5.0
    mirror_distance_mm: Positive = 200.0
    mirror_side_mm: Positive = 20.0
    mirror_mount_mm: NonNegative = 0.0
    spot_side_mm: Positive = 5.0
    arc_radius_mm: Positive = 300.0
    detector_diameter_mm: Positive = 5.0
    field_deg: Annotated[float, Gt(0.0), Lt(180.0)] = 0.5

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True)
class Instrument(Dimensions):
    """The goniophotometer's optics: dimensions, mirrors, detectors. The paper gives the distances of 200 mm, the mirrors'
    reflectance, the spot of 5 x 5 mm and the detectors. The rest is assumed. A pupil of 5 mm radius at 800 mm makes a beam of
    0.7 deg; the paper has 0.5 to 1 deg. An arc of 300 mm clears mirror 2, whose centre is at 283 mm.

    `mirror_reflectance`: reflectance of each mirror. `obstruction`: whether the mirror unit blocks light on its way to the
    detectors. `lit_everywhere`: whether the light covers the hole whatever is off, as with a larger slit. Otherwise it covers
    the slit's image.

    Without a sensor the detectors are the paper's virtual ones: discs that count the rays within the acceptance cone. With a
    sensor each detector is such a unit, with its lens in the place of the disc. The lens' diameter and the sensor's field then
    replace those of the dimensions: one instrument cannot have two kinds of detectors.

    Deviations are by element, each in its own frame. `pupil` is the illumination unit, about the centre of its exit pupil.
    `mirror_1` to `mirror_3` have x and y along their sides, and z along their normal. `mirror_unit` moves about the sample's
    centre, in the frame that turns with sigma: across, along the axis, towards the light. `sample` is in the frame that turns
    with gamma, and `arc` in that of the rig. `sensor` is each detector in its own frame: away from the normal, or along its
    arc; level; along its view. The illumination unit's own elements deviate within its frame, and its `unit` adds to `pupil`.

    Raises ValueError, naming the field, for a value out of range.
    """

    pupil_to_mirror_mm: Positive = 200.0
    mirror_reflectance: Share | Reflectance = MIRROR_REFLECTANCE
    obstruction: bool = True
    lit_everywhere: bool = field(default=False, metadata=LATER)
    deviations: Mapping[str, Deviation] = field(default_factory=dict, hash=False)
    illumination: Mapping[str, Deviation] = field(default_factory=dict, hash=False, metadata=LATER)
    sensor: RealSensor | None = None

    def __post_init__(self) -> None:
        if self.sensor is not None:
            object.__setattr__(self, "detector_diameter_mm", self.sensor.lens_diameter_mm)
            object.__setattr__(self, "field_deg", self.sensor.field_deg)
        super().__post_init__()
        for name, elements in (("deviations", ELEMENTS), ("illumination", ILLUMINATION_ELEMENTS)):
            known = check_deviations(getattr(self, name), elements, name)
            object.__setattr__(self, name, MappingProxyType(dict(sorted(known.items()))))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments: of a read-only mapping Python makes no copy."""
        own = {each.name: getattr(self, each.name) for each in fields(self) if each.init}
        given: dict[str, Any] = {k: dict(v) if isinstance(v, MappingProxyType) else v for k, v in own.items()}
        return partial(type(self), **given), ()

    def deviation(self, element: str) -> Deviation:
        """Deviation of one element; zero where none is given."""
        return self.deviations.get(element, NO_DEVIATION)

    @cached_property
    def deviation_rows(self) -> Floats:
        """All deviations as an argument of the kernels (elements, 6): see the function of this name. Do not write to it."""
        return deviation_rows(self.deviations)

    @cached_property
    def exit_pupil(self) -> Floats:
        """Exit pupil in the illumination unit's frame (3, 3): its centre, mm, and two unit axes. Do not write to it."""
        # It is the opening of the output condenser, which the whole unit carries.
        whole, shift = rotation_and_shift(self.illumination.get("unit", NO_DEVIATION))
        own, offset = rotation_and_shift(self.illumination.get("output_condenser", NO_DEVIATION))
        turn = whole @ own
        return np.array([whole @ offset + shift, turn[:, 0], turn[:, 2]])

    @cached_property
    def lengths(self) -> Floats:
        """Argument of the kernels (7,), mm: the entries are MIRROR_DISTANCE and the names that follow it."""
        return np.array(
            [
                self.mirror_distance_mm,
                self.pupil_to_mirror_mm,
                self.pupil_radius_mm,
                self.arc_radius_mm,
                0.5 * self.spot_side_mm,
                0.5 * self.mirror_side_mm,
                0.5 * self.blocking_side_mm,
            ]
        )

    def simplified(self) -> "Instrument":
        """The instrument with virtual detectors: discs with an acceptance cone, the only kind of the fast estimator.

        Raises ValueError, with the reason, if the sensor is not equivalent to such a detector (`RealSensor.simple`).
        """
        if self.sensor is None:
            return self
        if self.sensor.departure is not None:
            raise ValueError(
                f"the sensor is not a simple detector, a disc with an acceptance cone: {self.sensor.departure}; "
                "use the forward estimator, which traces lens, diaphragm and detector"
            )
        return replace(self, sensor=None)

    @property
    def blocking_side_mm(self) -> float:
        """Side of the square that blocks light: a mirror with its mount."""
        return self.mirror_side_mm + 2.0 * self.mirror_mount_mm

    @property
    def pupil_distance_mm(self) -> float:
        """Length of the beam's axis from the exit pupil over the three mirrors to the sample."""
        return self.pupil_to_mirror_mm + 3.0 * self.mirror_distance_mm

    @property
    def divergence_deg(self) -> float:
        """Full angle of the beam at the sample's centre."""
        return 2.0 * math.degrees(math.atan(self.pupil_radius_mm / self.pupil_distance_mm))

    @property
    def grey(self) -> bool:
        """Whether the mirrors' reflectance is independent of the wavelength."""
        return not isinstance(self.mirror_reflectance, Reflectance) or self.mirror_reflectance.wavelength_nm.size == 1


def deviation_rows(deviations: Mapping[str, Deviation], elements: Sequence[str] = ELEMENTS) -> Floats:
    """Deviations of one rig as an array (elements, 6): rows in the order of `elements`, columns in that of COMPONENTS.

    Elements that are not in `deviations` have none. Raises ValueError, listing the known elements, for an unknown name.
    """
    rows = np.zeros((len(elements), len(COMPONENTS)))
    for name, deviation in check_deviations(deviations, elements).items():
        rows[elements.index(name)] = astuple(deviation)
    return rows


def deviation_array(rigs: Iterable[Mapping[str, Deviation]]) -> Floats:
    """Deviations of many rigs (rigs, elements, 6): see `deviation_rows`."""
    return np.array([deviation_rows(each) for each in rigs]).reshape(-1, len(ELEMENTS), len(COMPONENTS))


def deviation_mapping(rows: Floats) -> dict[str, Deviation]:
    """Deviations of one rig by element from an array (elements, 6), the inverse of `deviation_rows`; zero ones are omitted."""
    return {name: Deviation(*row.tolist()) for name, row in zip(ELEMENTS, rows, strict=True) if np.any(row)}


@dataclass(frozen=True)
class SampleFrames:
    """The frames of the sample: one above and one below its sheet (paper, section 3.1). The paper gives no numbers: these are
    assumed. The hole of a frame is as wide as the instrument's spot. Without a gap it is the illuminated spot at every
    incidence, as in the fast estimator. With a gap the spot moves with sigma, and light is trapped between sample and frame.

    `gap_mm`: distance of each frame from the sample. `side_mm`: side of a frame, a square sheet without thickness.
    `reflectance`: fraction of light that the frames scatter by Lambert's law from either side. The rest is absorbed, as by
    black anodised metal. `lit`: side of the square that the uniform exit pupil lights, over that of the hole. A rayset lights
    the area that its rays reach.

    Raises ValueError, naming the field, for a value out of range.
    """

    gap_mm: NonNegative = 0.0
    side_mm: Positive = 60.0
    reflectance: Annotated[float, Ge(0.0), Le(1.0)] = 0.05
    lit: Annotated[float, Ge(1.0)] = 1.1

    def __post_init__(self) -> None:
        check_bounds(self)
        if 0.0 != self.gap_mm < LEAST_GAP_MM:
            raise ValueError(f"gap_mm is {self.gap_mm!r}: give 0, or at least {LEAST_GAP_MM:g} mm")
