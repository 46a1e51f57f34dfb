"""From the operator's part of a rig file to the drivers' settings and the geometry that plans are made with."""

from app.rig.schema import AXES, AxisTable, RigFile
from drivers import AxisSettings, MonitorSettings, MonochromatorSettings, PhotodiodeSettings
from twin.optics import Instrument


def axis_settings(file: RigFile) -> dict[str, AxisSettings]:
    """By axis."""
    return {name: _axis(name, getattr(file.axes, name)) for name in AXES}


def monochromator_settings(file: RigFile) -> MonochromatorSettings:
    """Of the monochromator."""
    return MonochromatorSettings(**file.monochromator.model_dump(exclude={"kind", "port"}))


def photodiode_settings(file: RigFile) -> PhotodiodeSettings:
    """Of the photodiodes and their modules."""
    table = file.photodiodes
    return PhotodiodeSettings(
        upper_deg=tuple(table.upper_deg),
        lower_deg=tuple(table.lower_deg),
        gains_v_per_a=tuple(table.gains_v_per_a),
        **table.model_dump(exclude={"kind", "units", "upper_deg", "lower_deg", "gains_v_per_a"}),
    )


def monitor_settings(file: RigFile) -> MonitorSettings:
    """Of the monitor."""
    return MonitorSettings(**file.monitor.model_dump(exclude={"kind", "usb"}))


def believed_instrument(file: RigFile) -> Instrument:
    """The instrument as the operator believes it to be: for the directions that the mirror unit hides."""
    return file.geometry.instrument()


def _axis(name: str, table: AxisTable) -> AxisSettings:
    return AxisSettings(
        name=name,
        speed=table.speed_deg_s,
        acceleration=table.acceleration_deg_s2,
        microstep_exponent=table.microsteps.bit_length() - 1,
        **table.model_dump(exclude={"speed_deg_s", "acceleration_deg_s2", "microsteps"}),
    )
