"""From the operator's part of a rig file to the drivers' settings and the geometry that plans are made with."""

from goniotwin.app.rig.file import AXES, AxisTable, RigFile
from goniotwin.app.rig.filters import filter_wheel
from goniotwin.drivers import ArcClearance, AxisSettings, Homing, MonitorSettings, MonochromatorSettings, PhotodiodeSettings
from goniotwin.protocols import adam
from goniotwin.twin.optics import Instrument


def axis_settings(file: RigFile) -> dict[str, AxisSettings]:
    """By axis."""
    return {name: _axis(name, getattr(file.axes, name)) for name in AXES}


def monochromator_settings(file: RigFile) -> MonochromatorSettings:
    """Of the monochromator."""
    table = file.monochromator
    return MonochromatorSettings(**table.model_dump(exclude={"kind", "port", "filters"}), wheel=filter_wheel(table.filters))


def photodiode_settings(file: RigFile) -> PhotodiodeSettings:
    """Of the photodiodes and their modules."""
    table = file.photodiodes
    values = table.model_dump(exclude={"units", "upper_deg", "lower_deg", "gains_v_per_a"})
    if adam.MODELS[table.kind].serial and "exchange_s" not in table.model_fields_set:
        values["exchange_s"] = adam.RTU_EXCHANGE_S
    return PhotodiodeSettings(
        upper_deg=tuple(table.upper_deg),
        lower_deg=tuple(table.lower_deg),
        gains_v_per_a=tuple(table.gains_v_per_a),
        **values,
    )


def monitor_settings(file: RigFile) -> MonitorSettings:
    """Of the monitor."""
    return MonitorSettings(**file.monitor.model_dump(exclude={"kind", "usb"}))


def believed_instrument(file: RigFile) -> Instrument:
    """The instrument as the operator believes it to be: for the directions that the mirror unit hides."""
    return file.geometry.instrument()


def arc_clearance(file: RigFile) -> ArcClearance:
    """What the arc must keep clear of."""
    return ArcClearance(top_polar_deg=max(*file.photodiodes.upper_deg, *file.photodiodes.lower_deg, 0.0))


def _axis(name: str, table: AxisTable) -> AxisSettings:
    homing = table.homing
    return AxisSettings(
        name=name,
        speed=table.speed_deg_s,
        acceleration=table.acceleration_deg_s2,
        microstep_exponent=table.microsteps.bit_length() - 1,
        stall_speed=table.stall_speed_deg_s,
        homing=None
        if homing is None
        else Homing(homing.mode, homing.speed_deg_s, homing.switch_speed_deg_s, homing.angle_deg, homing.longest_s),
        **table.model_dump(exclude={"speed_deg_s", "acceleration_deg_s2", "microsteps", "stall_speed_deg_s", "homing"}),
    )
