"""The twin that a real rig's file describes: a rehearsal needs one, and the operator's part says most of what it is.

Axes, photodiodes, gains, converters, the monochromator's speeds and the geometry are taken from what the operator believes.
So everything that the operator believes wrongly is wrong in this twin in the same way and cancels: that an axis has the
wrong `sense`, gear or offset, or a photodiode the wrong angle, *cannot be found by it*. Only the rig itself shows that, or a
twin of its own in a [twin] table that is not taken from the operator's part. What the file does not say is assumed, and told.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import tomlkit
from tomlkit.items import AbstractTable

from goniotwin.app.rig.addresses import RTU, rtu_address
from goniotwin.app.rig.file import AXES, AxisTable, RigFile
from goniotwin.app.rig.opening import TWIN, RigDescription, parse_rig
from goniotwin.app.rig.samples import sample_table
from goniotwin.twin.plant import Electronics, MonitorPhotodiode, MonochromatorDrive, WheelFilter
from goniotwin.twin.plant.converter import SETTLED

NAME = "described"
USUAL_SAMPLE = "gaussian:width_deg=5,reflectance=0.9"
SWITCHES_BEYOND_DEG = 1.0
RANGE_TO_SPARE = 2.0


@dataclass(frozen=True)
class DescribedTwin:
    """A virtual rig, and in words what was assumed where the file said nothing. `rig` is a whole rig file, text and all."""

    rig: RigDescription
    assumptions: tuple[str, ...]


def described_twin(real: RigDescription, etalon: str, samples: Iterable[str], models: Mapping[str, str]) -> DescribedTwin:
    """A virtual rig in this process for any rig's file; one that is such already stays what it is.

    `etalon` and `samples` are the schedule's names; `models` says by name what they are, in one line each (see
    app.rig.samples), before whatever the file says. Raises UserError for a model that is none.
    """
    document = tomlkit.parse(real.text)
    assumed: list[str] = []
    if not all(address.startswith(TWIN) for address in real.file.addresses):
        _connect_to_the_twin(document, real.file)
    if real.file.simulated is None:
        document["simulated"] = {"seed": 1}
    if real.file.twin is None:
        document["twin"] = _twin(real.file, assumed)
        _within_the_twins_means(document, real.file, assumed)
        for name in (etalon, *samples):
            if name not in models:
                table, told = _usual(real.file, name, etalon)
                _samples(document)[name] = table
                assumed.append(told)
    for name, model in models.items():
        _samples(document)[name] = sample_table(model)
    if document.unwrap() == tomlkit.parse(real.text).unwrap():
        return DescribedTwin(real, ())
    return DescribedTwin(parse_rig(tomlkit.dumps(document), real.folder, real.name), tuple(assumed))


def _connect_to_the_twin(document: tomlkit.TOMLDocument, file: RigFile) -> None:
    _table(document, "axes")["port"] = f"{TWIN}{NAME}/axes"
    _table(document, "monochromator")["port"] = f"{TWIN}{NAME}/mono"
    _table(document, "photodiodes")["units"] = [f"{TWIN}{NAME}/adc-{k}" for k in range(len(file.photodiodes.units))]
    _table(document, "monitor")["usb"] = f"{TWIN}{NAME}/monitor"


def _twin(file: RigFile, assumed: list[str]) -> dict[str, Any]:
    drive = file.monochromator
    assumed.append(
        "lamp, monitor, dark currents, the amplifiers' noise, the exit pupil and what mirrors reflect are the twin's own: the "
        "file says nothing of them"
    )
    filters = [each for each in drive.filters if each.cut_on_nm is not None]
    if drive.filters:
        assumed.append(
            f"filters that have a cut_on_nm let {WheelFilter.transmittance:g} of the light through from there on, and the "
            "grating has no second order that they could hold back"
        )
    geometry = file.geometry.model_dump(exclude={"shadow_margin_deg"})
    return {
        "axes": {name: _mechanics(name, getattr(file.axes, name), assumed) for name in AXES},
        "controller": _controller(file),
        "optics": geometry,
        "photodiodes": {"upper_deg": file.photodiodes.upper_deg, "lower_deg": file.photodiodes.lower_deg},
        "electronics": _electronics(file, assumed),
        "monochromator": {
            "slew_nm_per_s": drive.slew_nm_per_s, "settle_s": drive.slew_settle_s, "shutter_s": drive.shutter_s,
            "filter_s": drive.filter_s, "grating_s": drive.grating_s,
        },
        "filters": [{"position": each.position, "cut_on_nm": each.cut_on_nm} for each in filters],
        "samples": {},
    }  # fmt: skip


def _mechanics(name: str, axis: AxisTable, assumed: list[str]) -> dict[str, Any]:
    mechanics: dict[str, Any] = {
        "motor": axis.motor, "module": axis.module, "gear": axis.gear, "sense": axis.sense, "zero_deg": axis.zero_offset_deg,
        "full_steps": axis.full_steps, "encoder": axis.encoder, "backlash_deg": axis.backlash_deg,
    }  # fmt: skip
    if axis.encoder and axis.encoder_counts is not None:
        mechanics["encoder_counts"] = axis.encoder_counts
    if axis.switches:
        mechanics["lower_switch_deg"] = axis.lower_deg - SWITCHES_BEYOND_DEG
        mechanics["upper_switch_deg"] = axis.upper_deg + SWITCHES_BEYOND_DEG
        assumed.append(f"{name}'s limit switches are {SWITCHES_BEYOND_DEG:g} deg beyond its soft limits")
    return mechanics


def _controller(file: RigFile) -> dict[str, Any]:
    """One module with six motors, or where there are several addresses, a bus of them."""
    axes = [getattr(file.axes, name) for name in AXES]
    several = len({axis.module for axis in axes}) > 1
    single_motors = several and all(axis.motor == 0 for axis in axes)
    return {
        "kind": "tmcm-1240" if single_motors else "tmcm-6214",
        "wire": "rs485" if several else "usb",
        "baudrate": file.axes.baudrate,
    }


def _electronics(file: RigFile, assumed: list[str]) -> dict[str, Any]:
    table = file.photodiodes
    speed = min((10, 100), key=lambda known: abs(known - table.conversions_per_s))
    if speed != table.conversions_per_s:
        assumed.append(f"the converters make {speed} conversions a second, the nearest that they can do to what the file says")
    electronics: dict[str, Any] = {
        "gains_v_per_a": table.gains_v_per_a,
        "module": table.kind,
        "conversions_per_s": speed,
        "settling_s": min(Electronics.settling_s, table.settling_s / SETTLED),  # at rest when the operator believes it to be
    }
    if table.units[0].startswith(RTU):
        electronics["baudrate"] = rtu_address(table.units[0])[2]
    return electronics


def _within_the_twins_means(document: tomlkit.TOMLDocument, file: RigFile, assumed: list[str]) -> None:
    """What the twin has only one kind of is that kind, whatever the file says, or the drivers would not reach it at all."""
    if file.monochromator.baudrate != MonochromatorDrive.baudrate:
        _table(document, "monochromator")["baudrate"] = MonochromatorDrive.baudrate
        assumed.append(f"the monochromator's line has {MonochromatorDrive.baudrate} Bd, as the twin's")
    if file.monitor.dialect != "pm100d":
        _table(document, "monitor")["dialect"] = "pm100d"
        assumed.append("the monitor is a PM100D, as the twin's")
    least = RANGE_TO_SPARE * MonitorPhotodiode.current_a
    if file.monitor.range_a < least:
        _table(document, "monitor")["range_a"] = least
        assumed.append(f"the monitor's range is {least:g} A, for the twin's monitor gives {MonitorPhotodiode.current_a:g} A")
    for name in AXES:
        axis = getattr(file.axes, name)
        if axis.switches and (axis.right_polarity or axis.left_polarity):
            table = _table(_table(document, "axes"), name)
            table["right_polarity"] = table["left_polarity"] = 0
            assumed.append(f"{name}'s limit switches close at the end of its way, as the twin's")


def _usual(file: RigFile, name: str, etalon: str) -> tuple[dict[str, Any], str]:
    """What a sample is taken for of which nobody has said what it is."""
    say = f"say otherwise with --sample {name}=MODEL"
    if name != etalon:
        return sample_table(USUAL_SAMPLE), f"{name} scatters as a Gaussian of 5 deg with a reflectance of 0.9; {say}"
    reflectance = min(1.0, file.etalon.radiance_factor)
    return (
        sample_table(f"lambertian:reflectance={reflectance!r},side=both"),
        f"{name} is an ideal diffuser on both sides with a reflectance of {reflectance:g}, the etalon's radiance factor; {say}",
    )


def _samples(document: tomlkit.TOMLDocument) -> AbstractTable:
    return _table(_table(document, "twin"), "samples")


def _table(document: tomlkit.TOMLDocument | AbstractTable, name: str) -> AbstractTable:
    table = document[name]
    assert isinstance(table, AbstractTable)  # the file has been read, and checked, before
    return table
