"""The illumination unit: xenon arc, reflector, input condenser, monochromator, output condenser with the exit pupil.

Its frame has the directions of the rig's: y along the light, z up, x across. The origin is the centre of the exit pupil, which
is the output condenser's opening. Along y, from the back: reflector, arc, input condenser, slit, output condenser; the sample
is `sample_distance_mm` further on, with the mirrors unfolded.

The correction unit behind the output condenser, a beam splitter with a weak arm to the monitor photodiode, is not part of it
(nor of the paper's model): its shares cancel in every ratio. The plant has the monitor's current.
"""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.deviation import NO_DEVIATION, Deviation, check_deviations
from goniotwin.twin.optics.geometry.instrument import COMPONENTS, ILLUMINATION_ELEMENTS, Instrument, deviation_rows
from goniotwin.twin.optics.illumination.spectrum import Passband, Spectrum, xenon_spectrum

ELEMENTS = ILLUMINATION_ELEMENTS
# Order of the frames in the kernels' arguments.
ARC, REFLECTOR, INPUT, SLIT, OUTPUT = range(5)
SHARES = ("arc_transmittance", "bulb_transmittance", "reflector_reflectance", "monochromator_transmittance")


@dataclass(frozen=True, eq=False)
class IlluminationUnit:
    """Dimensions of the illumination unit (paper, section 3.1), in mm, nm and degrees; shares are of flux.

    The paper gives: arc, reflector, slit, ideal lenses, no loss except the reflector's. The rest is assumed:

    - The arc is a cylinder that emits uniformly from its volume into all directions; its axis is vertical (z, the slit's
      height). The bulb transmits `bulb_transmittance` at each passage and does not refract; direct light passes it once.
    - The reflector images the arc onto itself, upside down. Its light passes bulb, arc and electrodes again and so the bulb
      three times. `arc_transmittance` covers the losses in arc and electrodes for all of it, wherever it passes. With the
      defaults the reflector adds 62 %, the value stated by makers of such lamp housings.
    - The input condenser takes light up to f/1, and enlarges the arc `input_condenser_magnification` times onto the slit: five
      times. It then fills the exit pupil from all of the slit, with a margin of one millimetre for deviations.
    - Slit and height stop open `slit_width_mm` in x and the smaller of both heights in z. Wavelength does not depend on the
      position in the slit. The passband is a trapezoid about `wavelength_nm`: an interval (0: a triangle) with edges as wide as
      the bandwidth. `monochromator_transmittance` at its top is for grating and mirrors, with a value that gives about 0.2
      W/m^2 on the sample at 5 nm.
    - The output condenser images the slit onto the sample.

    An ideal lens maps straight lines to straight lines without loss, so that a ray keeps its flux; the radiance along it
    changes as the fourth power of the cosines on both sides (behind f/1 by up to a third).

    `deviations` has any of arc, reflector, input_condenser, slit (with its height stop), output_condenser (with the exit pupil)
    and unit (all of them together). Each turns about its reference point: the centres of arc, lenses and slit, the reflector's
    vertex, and for the unit that of the exit pupil. Raises ValueError, naming the field, for a value out of range, and for
    deviations of an unknown element.
    """

    lamp: Spectrum = field(default_factory=xenon_spectrum)
    arc_radius_mm: float = 0.5
    arc_length_mm: float = 2.2
    arc_transmittance: float = 0.8
    bulb_transmittance: float = 0.9
    reflector_radius_mm: float = 50.0
    reflector_half_angle_deg: float = 60.0
    reflector_reflectance: float = 0.95
    input_condenser_distance_mm: float = 50.0
    input_condenser_radius_mm: float = 25.0
    input_condenser_magnification: float = 5.0
    slit_width_mm: float = 0.5
    slit_height_mm: float = 4.0
    height_stop_mm: float = 0.5
    wavelength_nm: float = 555.0
    interval_nm: float = 0.0
    bandwidth_nm: float = 5.0
    monochromator_transmittance: float = 0.19
    output_condenser_magnification: float = 14.0
    exit_pupil_radius_mm: float = 5.0
    sample_distance_mm: float = 800.0
    field_side_mm: float = 5.0
    deviations: Mapping[str, Deviation] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name in ("lamp", "deviations"):
                continue
            value, least = getattr(self, entry.name), entry.name not in (*SHARES, "interval_nm")
            if not (math.isfinite(value) and (value > 0.0 if least else value >= 0.0)):
                wanted = "a positive, finite number" if least else "a finite number of at least 0"
                raise ValueError(f"{entry.name} is {value!r}: give {wanted}")
            if entry.name in SHARES and value > 1.0:
                raise ValueError(f"{entry.name} is {value!r}: give a share of at most 1")
        if self.reflector_half_angle_deg > 90.0:
            raise ValueError(f"reflector_half_angle_deg is {self.reflector_half_angle_deg!r}: give at most 90 deg")
        reach = math.hypot(self.arc_radius_mm, 0.5 * self.arc_length_mm)
        for name in ("reflector_radius_mm", "input_condenser_distance_mm"):
            if getattr(self, name) <= reach:
                raise ValueError(f"{name} is {getattr(self, name)!r}: the arc alone reaches {reach:.3g} mm")
        if self.wavelength_nm <= 0.5 * self.interval_nm + self.bandwidth_nm:
            raise ValueError(f"wavelength_nm is {self.wavelength_nm!r}: interval and bandwidth reach below 0")
        object.__setattr__(self, "deviations", check_deviations(self.deviations, ELEMENTS))

    @property
    def slit_distance_mm(self) -> float:
        """Distance from slit to output condenser (57 mm)."""
        return self.sample_distance_mm / self.output_condenser_magnification

    @property
    def opening_mm(self) -> tuple[float, float]:
        """Width (x) and height (z) of the opening of slit and height stop."""
        return self.slit_width_mm, min(self.slit_height_mm, self.height_stop_mm)

    @property
    def passband(self) -> Passband:
        """Passband of the monochromator, without its transmittance."""
        return Passband(self.wavelength_nm, self.interval_nm, self.bandwidth_nm)

    @cached_property
    def band_flux(self) -> float:
        """The arc's flux into all directions at the passing wavelengths, in the lamp's unit."""
        return self.passband.flux(self.lamp)

    @property
    def arc_volume_mm3(self) -> float:
        """Volume of the self-luminous cylinder."""
        return math.pi * self.arc_radius_mm**2 * self.arc_length_mm

    @cached_property
    def fingerprint(self) -> str:
        """16 hexadecimal digits, a hash of every dimension, share and deviation, the lamp's table and the passband."""
        digest = hashlib.blake2b(digest_size=8)
        for entry in fields(self):
            if entry.name not in ("lamp", "deviations"):
                digest.update(f"{entry.name}={float(getattr(self, entry.name))!r}\n".encode())
        for name in ELEMENTS:
            deviation = self.deviations.get(name, NO_DEVIATION)
            values = " ".join(repr(float(getattr(deviation, part.name))) for part in fields(deviation))
            digest.update(f"{name}={values}\n".encode())
        digest.update(self.lamp.unit.encode())
        for array in (self.lamp.wavelength_nm, self.lamp.flux_per_nm):
            digest.update(array.astype("<f8").tobytes())
        return digest.hexdigest()

    @cached_property
    def frames(self) -> Floats:
        """Frames of arc, reflector, input condenser, slit and output condenser, deviations included: (5, 4, 3) in mm.

        For each its reference point, and the unit vectors of its own x, y (along the light) and z.
        """
        frames: Floats = self.frames_of(deviation_rows(self.deviations, ELEMENTS)[None])[0]
        return frames

    def frames_of(self, deviations: Floats) -> Floats:
        """Frames (n, 5, 4, 3) for n sets of `deviations` (n, 6, 6), which replace the unit's own.

        They are of `ELEMENTS` in this order, each with the fields of a `Deviation` in theirs. Raises ValueError for another
        shape and for values that are not finite.
        """
        if deviations.ndim != 3 or deviations.shape[1:] != (len(ELEMENTS), len(COMPONENTS)):
            raise ValueError(f"deviations has the shape {deviations.shape}: give (n, 6, 6), of {', '.join(ELEMENTS)}")
        if not np.all(np.isfinite(deviations)):
            raise ValueError("deviations has one that is not finite: give degrees and mm")
        condenser = -self.slit_distance_mm - self.input_condenser_distance_mm * self.input_condenser_magnification
        arc = condenser - self.input_condenser_distance_mm
        places = np.zeros((5, 3))
        places[:, 1] = arc, arc - self.reflector_radius_mm, condenser, -self.slit_distance_mm, 0.0
        # Loads 328 modules, numba and importlib.metadata among them: 0.2 s, which `check` does without.
        from goniotwin.twin.optics.geometry.rotations import rotations

        turns = rotations(np.ascontiguousarray(deviations).reshape(-1, len(COMPONENTS))).reshape(-1, len(ELEMENTS), 3, 3)
        shifts = deviations[:, :, 3:]
        whole = turns[:, 5]
        frames = np.empty((len(deviations), 5, 4, 3))
        frames[:, :, 0] = (places + shifts[:, :5]) @ np.swapaxes(whole, 1, 2) + shifts[:, 5:]
        frames[:, :, 1:] = np.swapaxes(whole[:, None] @ turns[:, :5], 2, 3)
        return frames

    @cached_property
    def sizes(self) -> Floats:
        """Argument of the kernels, (13,), in mm.

        Arc radius and half length; reflector's radius and the cosine of its half-angle; of both lenses focal length and radius;
        half opening in x and z; shares of direct and of reflected light; distance of the sample.
        """
        near, far = self.input_condenser_distance_mm, self.input_condenser_distance_mm * self.input_condenser_magnification
        slit, sample = self.slit_distance_mm, self.sample_distance_mm
        direct = self.bulb_transmittance * self.monochromator_transmittance
        reflected = direct * self.bulb_transmittance**2 * self.reflector_reflectance * self.arc_transmittance
        width, height = self.opening_mm
        return np.array(
            [
                self.arc_radius_mm,
                0.5 * self.arc_length_mm,
                self.reflector_radius_mm,
                math.cos(math.radians(self.reflector_half_angle_deg)),
                near * far / (near + far),
                self.input_condenser_radius_mm,
                slit * sample / (slit + sample),
                self.exit_pupil_radius_mm,
                0.5 * width,
                0.5 * height,
                direct,
                reflected,
                sample,
            ]
        )


def unit_of(
    instrument: Instrument, wavelength_nm: float = 555.0, interval_nm: float = 0.0, bandwidth_nm: float = 5.0
) -> IlluminationUnit:
    """The illumination unit of an instrument: with its exit pupil, distance, field and deviations.

    A field above 5 mm has a wider slit and height stop, so that the slit's image covers it as it covers 5 mm. Raises ValueError
    as `IlluminationUnit`.
    """
    wider = max(1.0, instrument.spot_side_mm / IlluminationUnit.field_side_mm)
    return IlluminationUnit(
        slit_width_mm=wider * IlluminationUnit.slit_width_mm,
        height_stop_mm=wider * IlluminationUnit.height_stop_mm,
        slit_height_mm=wider * IlluminationUnit.slit_height_mm,
        wavelength_nm=wavelength_nm,
        interval_nm=interval_nm,
        bandwidth_nm=bandwidth_nm,
        exit_pupil_radius_mm=instrument.pupil_radius_mm,
        sample_distance_mm=instrument.pupil_distance_mm,
        field_side_mm=instrument.spot_side_mm,
        deviations=instrument.illumination,
    )
