"""Checks of the monitor."""

from goniotwin.drivers.checks.check import CheckOutcome, CheckSession, DeviceCheck, identity_check, judged, not_checked
from goniotwin.drivers.monitor.monitor import Monitor

LONGEST_REPLY_S = 0.1
MEAN_S = 1.0
DURATION = 0.1
DARK_PART = 0.01
"""Largest dark current over the range."""


def _settings(_session: CheckSession, device: Monitor, _subject: str) -> CheckOutcome:
    device.check()
    return judged(True, "range and averaging are accepted without an error", f"range {device.settings.range_a:g} A")


def _reply_times(session: CheckSession, device: Monitor, _subject: str) -> CheckOutcome:
    return session.reply_times(device.status_byte, LONGEST_REPLY_S)


def _mean(session: CheckSession, device: Monitor, _subject: str) -> CheckOutcome:
    took = session.wait(device.start_mean(MEAN_S))
    expected = f"a mean over {MEAN_S:g} s takes this time, at {device.settings.samples_per_s:g} samples a second"
    came = f"{took:.3f} s, which is {device.settings.samples_per_s * MEAN_S / took:.0f} samples a second"
    return judged(abs(took - MEAN_S) <= DURATION * MEAN_S, expected, came)


def _dark(session: CheckSession, device: Monitor, _subject: str) -> CheckOutcome:
    limit = DARK_PART * device.settings.range_a
    expected = f"below {limit:g} A with the shutter closed"
    monochromator = session.rig.monochromator
    if not session.connected(monochromator.name) or monochromator.shutter_is_open():
        return not_checked("the shutter is not known to be closed", expected)
    current = session.monitor_a()
    return judged(abs(current) <= limit, expected, f"{current:.3g} A")


MONITOR_CHECKS = (
    identity_check("maker, model, serial number, firmware"),
    DeviceCheck(
        "range and averaging are accepted",
        "no error in the instrument's queue",
        _settings,
        facts=("An error without a number", "Its commands", "Ranges 50 nA to 5 mA", "1 to 10,000 averages"),
    ),
    DeviceCheck(
        "reply times of the status byte",
        "at most 0.1 s",
        _reply_times,
        facts=("The instrument has interrupt IN",),
    ),
    DeviceCheck("a mean over one second", "it takes one second", _mean, facts=("`SENS:AVER` n",)),
    DeviceCheck("the dark current", "below a hundredth of the range", _dark),
)
