"""The virtual rig that a real rig's file describes, for its rehearsal.

Axes, photodiodes, gains, converters, times of the monochromator and the geometry are taken from the operator's part of the
file. So an error in that part is in this twin too, and cancels: a wrong `sense`, gear or offset of an axis, or a wrong angle
of a photodiode, *cannot be found with it*. Only the real rig shows such an error, or a [twin] table that is not taken from
the operator's part. Properties that the file does not have are assumed, and listed as assumptions.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import tomlkit
from tomlkit.items import AbstractTable

from goniotwin.app.errors import UserError
from goniotwin.app.rig.addresses import RTU, TWIN, rtu_address
from goniotwin.app.rig.alignment import AlignmentFile, parse_alignment
from goniotwin.app.rig.axes import AXES
from goniotwin.app.rig.description import RigDescription, parse_rig
from goniotwin.app.rig.file import RigFile, nominal_instrument, set_addresses
from goniotwin.app.rig.inputs import element_deviations
from goniotwin.app.rig.kinds import ROLES, device_kind
from goniotwin.app.rig.makes import DEFAULT_KIND, OWN_KINDS, MonitorTable, MonochromatorTable, PhotodiodesTable
from goniotwin.app.rig.samples import sample_table
from goniotwin.drivers import AxisSettings
from goniotwin.keys import values_of
from goniotwin.twin.addresses import AXES as AXES_LINE
from goniotwin.twin.optics import Dimensions
from goniotwin.twin.plant import Electronics, MonitorPhotodiode, MonochromatorDrive, WheelFilter
from goniotwin.twin.plant.converter import SETTLED

NAME = "described"
DEFAULT_SAMPLE = "gaussian:width_deg=5,reflectance=0.9"
RANGE_MARGIN = 2.0
"""Range of the monitor over its current, at least."""


class NoDescription(UserError):
    """A twin of a device cannot be described from the operator's part."""

    def __init__(self, place: str, kind: str) -> None:
        super().__init__(
            f"{place}: there is no description of a twin for the kind {kind!r}; describe the virtual rig in a [twin] table"
        )


@dataclass(frozen=True)
class DescribedTwin:
    """A virtual rig, and the assumptions about properties that the rig file does not have. `rig` has a complete file text."""

    rig: RigDescription
    assumptions: tuple[str, ...]


def described_twin(
    real: RigDescription, standards: str | Mapping[str, float | None], samples: Iterable[str], models: Mapping[str, str]
) -> DescribedTwin:
    """The virtual rig in this process for a rig file; a file that describes such a rig already is not changed.

    `standards` are the etalon's name, or several with the radiance factor that the schedule states, None for the etalon's;
    `samples` are those in the schedule. `models` has samples in one line (see
    `app.rig.samples`) by name; they replace those of the file. Raises NoDescription, and UserError for an invalid model or
    a controller without a twin.
    """
    document = tomlkit.parse(real.text)
    assumptions: list[str] = []
    factors = {standards: None} if isinstance(standards, str) else standards
    if not real.file.in_process:
        _check_controllers(real)
        set_addresses(document, real.file, lambda device: f"{TWIN}{NAME}/{device.twin}")
    if real.file.simulated is None:
        document["simulated"] = {"seed": 1}
    if real.file.twin is None:
        document["twin"] = _twin_table(real.file, assumptions)
        if real.alignment is not None:
            far = nominal_instrument(real.file).pupil_distance_mm
            _misalign(document, parse_alignment(real.alignment, real.name), far)
        _set_twin_devices(document, real.file, assumptions)
        for name in (*factors, *samples):
            if name not in models:
                table, assumption = (
                    _default_standard(real.file, name, factors[name]) if name in factors else _default_sample(name)
                )
                _samples(document)[name] = table
                assumptions.append(assumption)
    for name, model in models.items():
        _samples(document)[name] = sample_table(model)
    if document.unwrap() == tomlkit.parse(real.text).unwrap():
        return DescribedTwin(real, ())
    return DescribedTwin(parse_rig(tomlkit.dumps(document), real.folder, real.name, real.alignment), tuple(assumptions))


def _misalign(document: tomlkit.TOMLDocument, alignment: AlignmentFile, pupil_distance_mm: float) -> None:
    """Set the described twin off by what the rig's alignment has found: its values are corrected by that."""
    twin = _table(document, "twin")
    found = element_deviations(alignment.inputs, pupil_distance_mm)
    twin["deviations"] = {element: vars(each) for element, each in found.items()}
    for axis, table in _table(twin, "axes").items():
        table["zero_deg"] = table.get("zero_deg", 0.0) + alignment.inputs.get(f"{axis}_zero", 0.0)


def _check_controllers(real: RigDescription) -> None:
    """Raise UserError if two controllers of the rig would be one device of its `[twin]`."""
    of_twin: dict[str, str] = {}
    for device in real.file.devices[: len(real.file.axes.controllers)]:
        other = of_twin.setdefault(device.twin, device.name)
        if other != device.name:
            wrong = f"{real.name}: twin.controllers: has no table for {device.name}, which has a port of its own"
            raise UserError(f"{wrong}; add one with the axes of {device.name}")


def _twin_table(file: RigFile, assumptions: list[str]) -> dict[str, Any]:
    for role in ROLES[1:]:
        kind = device_kind(role, getattr(file, role).kind)
        if kind not in OWN_KINDS:
            raise NoDescription(role, kind.name)
    drive = file.monochromator
    assert isinstance(drive, MonochromatorTable)
    assumptions.append(
        "lamp, monitor, dark currents, noise of the amplifiers, exit pupil and reflectance of the mirrors are the defaults of "
        "the twin, because the file does not have them"
    )
    filters = [each for each in drive.filters if each.cut_on_nm is not None]
    if drive.filters:
        assumptions.append(
            f"filters with a cut_on_nm transmit {WheelFilter.transmittance:g} of the light from there on, and the grating has "
            "no second order for them to block"
        )
    return {
        **_motion(file, assumptions),
        "optics": values_of(file.geometry, Dimensions),
        "photodiodes": {"upper_deg": file.photodiodes.upper_deg, "lower_deg": file.photodiodes.lower_deg},
        "electronics": _electronics(file, assumptions),
        "monochromator": {
            "slew_nm_per_s": drive.slew_nm_per_s,
            "settle_s": drive.slew_settle_s,
            "shutter_s": drive.shutter_s,
            "filter_s": drive.filter_s,
            "grating_s": drive.grating_s,
        },
        "filters": [{"position": each.position, "cut_on_nm": each.cut_on_nm} for each in filters],
        "samples": {},
    }


def _motion(file: RigFile, assumptions: list[str]) -> dict[str, Any]:
    """The axes of the virtual rig and their controllers. Raises NoDescription."""
    axes, tables, further = dict[str, Any](), dict[str, Any](), dict[str, Any]()
    for controller in file.axes.controllers:
        if controller.kind.describe is None:
            raise NoDescription(".".join(controller.places[0]), controller.kind.name)
        table, mechanics = controller.kind.describe(controller.table, controller.axes, assumptions)
        axes |= mechanics
        if controller.kind.name == DEFAULT_KIND and controller.name == AXES_LINE:
            tables["controller"] = table
        else:
            further[controller.name] = {**table, "axes": list(controller.axes)}
    return {"axes": {name: axes[name] for name in AXES}, **tables, **({"controllers": further} if further else {})}


def _electronics(file: RigFile, assumptions: list[str]) -> dict[str, Any]:
    table = file.photodiodes
    assert isinstance(table, PhotodiodesTable)
    speed = min((10, 100), key=lambda known: abs(known - table.conversions_per_s))
    if speed != table.conversions_per_s:
        assumptions.append(f"the converters make {speed} conversions a second, the possible rate next to that of the file")
    electronics: dict[str, Any] = {
        "gains_v_per_a": table.gains_v_per_a,
        "module": table.kind,
        "conversions_per_s": speed,
        "raw_format": table.raw_format,
        "settling_s": min(Electronics.settling_s, table.settling_s / SETTLED),  # settled within the operator's settling time
    }
    if table.units[0].startswith(RTU):
        electronics["baudrate"] = rtu_address(table.units[0])[2]
    return electronics


def _set_twin_devices(document: tomlkit.TOMLDocument, file: RigFile, assumptions: list[str]) -> None:
    """Set the operator's part to the twin's kinds of devices, where it has only one: the drivers could not reach another."""
    assert isinstance(file.monochromator, MonochromatorTable)
    assert isinstance(file.monitor, MonitorTable)
    if file.monochromator.baudrate != MonochromatorDrive.baudrate:
        _table(document, "monochromator")["baudrate"] = MonochromatorDrive.baudrate
        assumptions.append(f"the monochromator's line has {MonochromatorDrive.baudrate} Bd, like the twin's")
    if file.monitor.dialect != "pm100d":
        _table(document, "monitor")["dialect"] = "pm100d"
        assumptions.append("the monitor is a PM100D, like the twin's")
    lowest_range_a = RANGE_MARGIN * MonitorPhotodiode.current_a
    if file.monitor.range_a < lowest_range_a:
        _table(document, "monitor")["range_a"] = lowest_range_a
        current = f"{MonitorPhotodiode.current_a:g} A"
        assumptions.append(f"the monitor's range is {lowest_range_a:g} A, because the twin's monitor gives {current}")
    for name, axis in file.axes.by_name.items():
        if isinstance(axis, AxisSettings) and axis.switches and (axis.right_polarity or axis.left_polarity):
            table = _table(_table(document, "axes"), name)
            table["right_polarity"] = table["left_polarity"] = 0
            assumptions.append(f"{name}'s limit switches close at the end of its travel, like the twin's")


def _default_sample(name: str) -> tuple[dict[str, Any], str]:
    """The table of a sample that is described nowhere, and the assumption."""
    return sample_table(DEFAULT_SAMPLE), (
        f"{name} scatters as a Gaussian of 5 deg with a reflectance of 0.9; for another model give --sample {name}=MODEL"
    )


def _default_standard(file: RigFile, name: str, factor: float | None) -> tuple[dict[str, Any], str]:
    """The table of a standard that is described nowhere, by its certified factor or the etalon's, and the assumption."""
    reflectance = min(1.0, file.etalon.radiance_factor if factor is None else factor)
    whose = "the etalon's" if factor is None else "its certified"
    return sample_table(f"lambertian:reflectance={reflectance!r},side=both"), (
        f"{name} is an ideal diffuser on both sides with a reflectance of {reflectance:g}, {whose} radiance factor; for "
        f"another model give --sample {name}=MODEL"
    )


def _samples(document: tomlkit.TOMLDocument) -> AbstractTable:
    return _table(_table(document, "twin"), "samples")


def _table(document: tomlkit.TOMLDocument | AbstractTable, name: str) -> AbstractTable:
    table = document[name]
    assert isinstance(table, AbstractTable)  # the file was validated before
    return table
