"""How long each row takes on the rig's clock: ramps, settling, conversions, and the bytes on the wires."""

from app.campaign.row import Row
from app.rig import AXES, RigFile, axis_settings, monochromator_settings, photodiode_settings
from drivers.axis import ARRIVED_AFTER_S
from drivers.monitor import ANSWER_MARGIN_S
from drivers.monochromator import STATUS_MARGIN_S
from protocols.cornerstone import Statement, encode_nm
from protocols.tmcl import FRAME_BYTES

CONTROLLER_LATENCY_S = 3.0e-4
USB_LATENCY_S = 1.0e-3


class Timing:
    """Follows the rows of a plan in order, knowing where each left the rig."""

    def __init__(self, rig: RigFile) -> None:
        self._axes = axis_settings(rig)
        self._monochromator = monochromator_settings(rig)
        self._photodiodes = photodiode_settings(rig)
        self._exchange_s = 2 * FRAME_BYTES * 10.0 / rig.axes.baudrate + CONTROLLER_LATENCY_S
        encoders = sum(settings.encoder for settings in self._axes.values())
        self._readback_s = 2 * (len(AXES) + encoders) * self._exchange_s  # each with the canary
        # Where the axes stand before the first row nobody knows; at the origin of their counters is a fair guess.
        self._pose = {name: settings.zero_offset_deg for name, settings in self._axes.items()}
        self._commanded: dict[str, float] = {}
        self._wavelength_nm: float | None = None
        self._shutter_open: bool | None = None
        self._gain: int | None = None

    def row_seconds(self, row: Row) -> float:
        """The duration of the next row, s; a person's time at mountings is not in it."""
        if row.kind == "mount":
            return self._shutter(opened=False)
        if row.kind == "dark":
            return self._shutter(opened=False) + self._readings(row)
        return self._moves(row) + self._readings(row) + self._readback_s

    def _moves(self, row: Row) -> float:
        assert row.pose is not None
        assert row.wavelength_nm is not None
        begun = done = settling = 0.0
        for name, target in zip(AXES, row.pose, strict=True):
            if self._commanded.get(name) == target:
                continue
            begun += 3 * self._exchange_s  # where it is, the canary, the move
            ramp = self._axes[name].seconds_between(self._pose[name], target)
            done = max(done, begun + ramp + ARRIVED_AFTER_S) + 2 * self._exchange_s  # whether it has arrived, the canary
            settling = max(settling, self._axes[name].settling_s)
            self._pose[name] = self._commanded[name] = target
        if row.wavelength_nm != self._wavelength_nm:
            settings = self._monochromator
            known = self._wavelength_nm
            way = 0.0 if known is None else row.wavelength_nm - known
            text = str(Statement("GOWAVE", parameter=encode_nm(row.wavelength_nm)))
            asked = settings.question_seconds("WAVE?", encode_nm(row.wavelength_nm))
            done = max(done, begun + self._statement(text, settings.slew_seconds(way)) + asked)
            self._wavelength_nm = row.wavelength_nm
        return done + self._shutter(opened=True) + settling

    def _readings(self, row: Row) -> float:
        settings = self._photodiodes
        seconds = 0.0
        for gain in row.gains:
            if gain != self._gain:
                seconds += settings.gain_seconds
                self._gain = gain
            last = (row.readings - 1) * settings.period_s
            fetching = max(settings.fetching_seconds, ANSWER_MARGIN_S + 4 * USB_LATENCY_S)
            seconds += settings.wait_s + last + fetching
        return seconds

    def _shutter(self, *, opened: bool) -> float:
        if self._shutter_open is opened:
            return 0.0
        self._shutter_open = opened
        asked = self._monochromator.question_seconds("SHUTTER?", "O")
        return self._statement(f"SHUTTER {'O' if opened else 'C'}", self._monochromator.shutter_s) + asked

    def _statement(self, text: str, seconds: float) -> float:
        return seconds + self._monochromator.statement_seconds(text) + STATUS_MARGIN_S
