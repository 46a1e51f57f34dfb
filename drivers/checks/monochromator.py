"""Checks of the monochromator: its line, its wavelength, its shutter and its filter wheel."""

import contextlib
import math

import numpy as np

from goniotwin.drivers.checks.check import CheckOutcome, CheckSession, DeviceCheck, identity_check, judged, not_checked
from goniotwin.drivers.errors import DeviceError
from goniotwin.drivers.monochromator.monochromator import Monochromator

LONGEST_REPLY_S = 0.3
"""A reply is at most 100 ms later than its echo; the characters of both take the rest at 9600 Bd."""
CHANGE_NM = 50.0
DURATION = 0.25
"""Largest relative difference of a duration from the rig file's, and `LATE_S` in addition."""
LATE_S = 0.2
LIGHT, LEAST_LIGHT = 10.0, 0.01
"""Least ratio of the monitor's currents with the shutter open and closed, and of the open one to the monitor's range."""


def _line(_session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    device.check()
    return judged(True, "echo and handshake mode are detected, wavelengths are in nm", f"{device.modes}, nm")


def _reply_times(session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    return session.reply_times(device.wavelength_nm, LONGEST_REPLY_S)


def _wavelength(_session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    lowest, highest, here = device.settings.lowest_nm, device.settings.highest_nm, device.wavelength_nm()
    return judged(lowest <= here <= highest, f"{lowest:g} to {highest:g} nm", f"{here:g} nm")


def _grating(_session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    grating = device.grating()
    came = f"grating {grating.number}, {grating.lines_per_mm} lines/mm, {grating.label}"
    return judged(grating.lines_per_mm > 0, "number, lines/mm and label of the grating in the beam, as on its plate", came)


def _wheel(_session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    here, positions = device.filter(), sorted(each.position for each in device.settings.wheel.filters)
    if not positions:
        return judged(True, "any position, or 0 without a wheel", f"position {here}")
    return judged(1 <= here <= 6, "a position from 1 to 6", f"position {here}" if here else "0: it has no filter wheel")


def _shutter(_session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    is_open = device.shutter_is_open()
    return judged(not is_open, "the shutter is closed", "open: light reaches the sample" if is_open else "closed")


def _change(session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    start = device.wavelength_nm()
    target = start + (CHANGE_NM if start + CHANGE_NM <= device.settings.highest_nm else -CHANGE_NM)
    expected_s = _change_s(device, start, target)
    expected = f"to {target:g} nm and back to {start:g} nm, each in {expected_s:.2f} s"
    durations = [session.wait(device.start_wavelength(each)) for each in (target, start)]
    came = " and ".join(f"{each:.2f} s" for each in durations)
    return judged(all(_in_time(each, expected_s) for each in durations), expected, came)


def _light(session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    largest_a = session.rig.monitor.settings.largest_a
    least_a = LEAST_LIGHT * largest_a if math.isfinite(largest_a) else 0.0
    expected = f"the monitor reads {LIGHT:g} times more with the shutter open, and {least_a:g} A at least"
    if not session.connected(session.rig.monitor.name):
        return not_checked("the monitor is not connected, and nothing else shows the light", expected)
    if device.shutter_is_open():
        return not_checked("the shutter is open; close it first", expected)
    before = session.monitor_a()
    with session.open_shutter():
        light = session.monitor_a()
    after = session.monitor_a()
    came = f"closed {before:.3g} A, open {light:.3g} A, closed {after:.3g} A"
    least = max(LIGHT * abs(before), least_a)
    if light < least:
        return judged(False, expected, f"{came}: the shutter stays shut, or there is no light (lamp, wavelength)")
    if abs(after) > abs(light) / LIGHT:
        return judged(False, expected, f"{came}: the shutter stays open")
    return judged(True, expected, came)


def _turn_wheel(session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    positions = sorted(each.position for each in device.settings.wheel.filters)
    start = device.filter()
    others = [each for each in positions if each != start]
    if start == 0 or not others:
        return not_checked("the rig file has no other filter, so that the wheel is never turned")
    target = min(others, key=lambda each: abs(each - start))
    expected_s = abs(target - start) * device.settings.wheel.step_s
    durations = [session.wait(device.start_filter(each)) for each in (target, start)]
    expected = f"to position {target} and back to {start}, each in {expected_s:.2f} s"
    came = " and ".join(f"{each:.2f} s" for each in durations)
    return judged(all(_in_time(each, expected_s) for each in durations), expected, came)


def _abort(session: CheckSession, device: Monochromator, _subject: str) -> CheckOutcome:
    start = device.wavelength_nm()
    distance = min(2.0 * CHANGE_NM, max(device.settings.highest_nm - start, start - device.settings.lowest_nm))
    target = start + distance if start + distance <= device.settings.highest_nm else start - distance
    whole_s = _change_s(device, start, target)
    pending = device.start_wavelength(target)
    pending.poll()  # it is on the wire
    session.rig.clock.sleep_until(session.rig.clock.now() + 0.4 * whole_s)
    begun = session.rig.clock.now()
    device.stop()
    expected = f"the grating stops at once, short of {target:g} nm"
    with contextlib.suppress(DeviceError):  # it has not arrived: the wavelength decides
        session.wait(pending)
    here, took = device.wavelength_nm(), session.rig.clock.now() - begun
    session.wait(device.start_wavelength(start))
    return judged(
        abs(here - target) > 0.1 * distance,
        expected,
        f"it stopped at {here:g} nm; its position was read {took:.2f} s after ABORT",
    )


def _change_s(device: Monochromator, start_nm: float, target_nm: float) -> float:
    """Duration of a change of wavelength by the rig file, s, without the filter wheel, which these checks turn by itself."""
    start, target = np.array([start_nm]), np.array([target_nm])
    return float((device.settings.wavelength_seconds(start, target) - device.settings.wheel.seconds(start, target))[0])


def _in_time(took_s: float, expected_s: float) -> bool:
    return abs(took_s - expected_s) <= DURATION * expected_s + LATE_S


MONOCHROMATOR_CHECKS = (
    identity_check("the maker's text, with its model"),
    DeviceCheck(
        "echo, handshake mode and units of the line",
        "they are detected",
        _line,
        facts=("9600 Bd, 8N1", "`HANDSHAKE?` answers"),
    ),
    DeviceCheck("reply times", "at most 0.3 s", _reply_times, facts=("A reply begins 2 ms",)),
    DeviceCheck("the wavelength", "within the rig file's range", _wavelength, facts=("Decimals of wavelengths",)),
    DeviceCheck("the grating in the beam", "number, lines/mm and label, as on its plate", _grating),
    DeviceCheck("the position of the filter wheel", "a position from 1 to 6 where the rig file has filters", _wheel),
    DeviceCheck("the shutter as it is found", "closed", _shutter),
    DeviceCheck(
        "a change of wavelength there and back",
        "the rig file's time, and `WAVE?` at the target",
        _change,
        moves=True,
        facts=("While something moves it hears", "175 nm/s"),
    ),
    DeviceCheck(
        "ABORT in the middle of a change of wavelength",
        "the grating stops short of its target",
        _abort,
        moves=True,
        facts=("`ABORT` stops the grating",),
    ),
    DeviceCheck(
        "shutter open and closed, with the monitor's light",
        "ten times more light with the shutter open",
        _light,
        moves=True,
        facts=("175 nm/s",),
    ),
    DeviceCheck(
        "the filter wheel to another position and back",
        "the rig file's time, and `FILTER?` at the target",
        _turn_wheel,
        moves=True,
        facts=("The wheel goes to a position", "175 nm/s"),
    ),
)
