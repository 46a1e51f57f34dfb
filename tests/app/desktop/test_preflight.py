"""The preflight list: each check from its facts."""

from dataclasses import replace
from datetime import date

import pytest

from goniotwin.app.campaign.readout import WarmUpTrace
from goniotwin.app.desktop.model.preflight import MARKS, Facts, Outcome, preflight_checks, preflight_summary
from goniotwin.app.station.messages import Contact, DeviceStatus

ANSWERS = DeviceStatus(Contact.CONNECTED, "TMCM-6214")
LOST = DeviceStatus(Contact.DISCONNECTED, error="no reply")
TODAY = date(2026, 11, 23)
CHECKS = ("Ports", "Homed", "Limits", "Lamp", "Dark reading", "Drift", "Certificate", "Disk")


def trace(percent_in_10_min: float, readings: int = 61, noise: float = 0.0) -> WarmUpTrace:
    """Readings of the monitor every 10 s, on a straight line, alternately above and below it by `noise`."""
    found = WarmUpTrace()
    for k in range(readings):
        found.add(10.0 * k, 1e-7 * (1.0 + 0.01 * percent_in_10_min * k / 60.0 + noise * (-1.0) ** k))
    return found


READY = Facts(
    today=TODAY,
    devices={"axes": ANSWERS, "monitor": ANSWERS},
    limits_deg={"sigma": (0.0, 180.0)},
    positions_deg={"sigma": 30.0},
    monitor=trace(0.1),
    dark_age_s=20.0,
    drift="+0.12 % (limit 0.5 %)",
    expires=date(2027, 6, 1),
    folder="/data",
    free_bytes=200_000_000_000,
    needed_bytes=3_000_000,
)


def test_all_is_ready() -> None:
    checks = preflight_checks(READY)
    assert tuple(each.name for each in checks) == CHECKS
    assert [each.outcome for each in checks] == [Outcome.GOOD] * len(CHECKS)
    assert not any(each.remedy for each in checks)
    assert preflight_summary(checks) == "Ready"


def test_nothing_is_known_and_nothing_is_called_good() -> None:
    checks = preflight_checks(Facts(today=TODAY))
    assert Outcome.GOOD not in {each.outcome for each in checks}
    assert preflight_summary(checks) == "Not ready: ports, disk"


@pytest.mark.parametrize(
    ("name", "changes", "outcome", "found", "remedy"),
    [
        ("Ports", {"devices": {"axes": ANSWERS, "monitor": LOST}}, "bad", "not responding: monitor", "cable"),
        ("Homed", {"unreferenced": {"sigma": "it has reset"}, "homes": ("sigma",)}, "bad", "is unreferenced", "home sigma"),
        ("Homed", {"unreferenced": {"sigma": "it has reset"}}, "bad", "it has reset", "set the position of sigma"),
        ("Homed", {"silent_axes": ("sigma",)}, "unknown", "not responding: sigma", "cable"),
        ("Limits", {"unreferenced": {"sigma": "it has reset"}}, "unknown", "unreferenced: sigma", ""),
        ("Limits", {"silent_axes": ("sigma",)}, "unknown", "not responding: sigma", "cable"),
        ("Limits", {"positions_deg": {"sigma": -3.0}}, "bad", "sigma is at −3.00°, outside 0 to 180°", "soft limits"),
        ("Limits", {"positions_deg": {"sigma": 180.01}}, "good", "within", ""),
        ("Limits", {"positions_deg": {}}, "unknown", "no positions", ""),
        ("Lamp", {"monitor": trace(3.0)}, "look", "+2.96 % in 10 min", "wait"),
        ("Lamp", {"monitor": trace(3.0), "warm_percent": 4.0}, "good", "accepted 4 %", ""),
        ("Lamp", {"monitor": trace(0.1, readings=5)}, "unknown", "too few", "a minute"),
        ("Lamp", {"monitor": trace(0.0, readings=9, noise=0.01)}, "look", "(u ", "read Live for longer"),
        ("Lamp", {"monitor_age_s": 3600.0}, "look", "1 h 00 min ago", "again"),
        ("Dark reading", {"dark_age_s": 61.0}, "look", "1 min 01 s old", "a new one"),
        ("Dark reading", {"dark_age_s": 61.0, "dark_every_s": 600.0}, "good", "renewed after 10 min 00 s", ""),
        ("Dark reading", {"dark_age_s": 30.0, "speed": 60.0}, "good", "simulated time, at 60x", ""),
        ("Dark reading", {"dark_age_s": None}, "unknown", "none", "begins with one"),
        ("Drift", {"drift": "beyond the limit: +2 %", "drift_beyond": True}, "look", "+2 %", "cause"),
        ("Drift", {"drift": "", "drift_planned": False}, "look", "no drift checks", "[drift]"),
        ("Drift", {"drift": ""}, "unknown", "no drift check yet", ""),
        ("Certificate", {"expires": date(2026, 11, 22)}, "bad", "expired on 2026-11-22, 1 day ago", "[certificate]"),
        ("Certificate", {"expires": TODAY}, "look", "0 days", "renewed"),
        ("Certificate", {"expires": date(2026, 1, 1), "accepted_by": "B. Muster"}, "look", "accepted by B. Muster", "again"),
        ("Certificate", {"expires": None, "calibrated": date(2026, 11, 1)}, "good", "22 days ago", ""),
        ("Certificate", {"expires": None}, "look", "no date of calibration", "[etalon]"),
        ("Disk", {"free_bytes": 150_000_000}, "bad", "150 MB free", "room"),
        ("Disk", {"free_bytes": 5_000_000_000, "needed_bytes": 3_000_000_000}, "bad", "takes about 3 GB", "room"),
        ("Disk", {"free_bytes": 1_500_000_000}, "look", "1.5 GB", "soon"),
        ("Disk", {"free_bytes": None}, "bad", "/data: cannot be read", "another folder"),
    ],
)
def test_a_check_states_what_is_found_and_what_to_do(
    name: str, changes: dict[str, object], outcome: str, found: str, remedy: str
) -> None:
    (check,) = [each for each in preflight_checks(replace(READY, **changes)) if each.name == name]  # type: ignore[arg-type]  # fields by name
    assert check.outcome is Outcome[outcome.upper()]
    assert found in check.found
    assert remedy in check.remedy
    assert bool(check.remedy) == (remedy != "")
    assert check.text.startswith(f"{name}: {check.outcome}: ")


def test_the_marks_differ_without_their_colour() -> None:
    assert len(set(MARKS.values())) == len(Outcome)


def test_the_summary_names_what_to_look_at() -> None:
    assert (
        preflight_summary(preflight_checks(replace(READY, dark_age_s=100.0, drift="", drift_planned=False)))
        == "Look at: dark reading, drift"
    )
    assert preflight_summary(preflight_checks(replace(READY, dark_age_s=None, monitor=None))) == "Ready, 2 not measured yet"
