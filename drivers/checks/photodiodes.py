"""Checks of the photodiodes, their amplifiers and converters."""

from itertools import combinations

import numpy as np

from goniotwin.arrays import Flags, Floats
from goniotwin.drivers.checks.check import CheckOutcome, CheckSession, DeviceCheck, identity_check, judged, not_checked
from goniotwin.drivers.errors import LimitError
from goniotwin.drivers.photodiodes.adam import AdamModule
from goniotwin.drivers.photodiodes.array import PhotodiodeArray
from goniotwin.drivers.photodiodes.settings import PhotodiodeSettings

DARK_PART = 0.1
"""Largest dark level over the end of the range, at any gain."""
DARK_RATIO = 10.0
"""A dark level at the highest gain is less than this factor from the median of all channels."""
SEEN = 10.0
"""Light is seen where it is this many times the standard deviation of the difference of two means."""
DEAD_PART = 0.1
SMOOTH = 0.15
"""Largest relative difference of a channel from its neighbours, on a white sample, over the cosine of its polar angle."""
NEIGHBOURS = 5
POSE_DEG = {"beta": 180.0, "sigma": 30.0}
"""Here the whole upper arc sees an opaque sample, and the mirror unit hides none of it."""
WHITE = "etalon"
EMPTY: Floats = np.zeros(0)


def _module(device: PhotodiodeArray, subject: str) -> AdamModule:
    return device.modules[device.parts.index(subject)]


def _identity(_session: CheckSession, device: PhotodiodeArray, subject: str) -> CheckOutcome:
    identity = _module(device, subject).identity
    return judged(identity.startswith(device.model), f"{device.model}, with its firmware", identity or "none")


def _reply_times(session: CheckSession, device: PhotodiodeArray, subject: str) -> CheckOutcome:
    longest_s = device.settings.period_s / len(device.modules)
    return session.reply_times(_module(device, subject).counts, longest_s)


def _settings(_session: CheckSession, device: PhotodiodeArray, subject: str) -> CheckOutcome:
    module = _module(device, subject)
    module.check_ranges()
    module.check_enabled()
    code = device.settings.range.code
    return judged(True, f"range 0x{code:04X} in eight channels, all enabled", "the same")


def _gains(session: CheckSession, device: PhotodiodeArray, _subject: str) -> CheckOutcome:
    gains = device.settings.gains_v_per_a
    for index in range(len(gains)):
        session.volts(index, 1)  # which confirms the outputs
    expected = f"{len(gains)} gains are set, and the outputs read back"
    return judged(True, expected, ", ".join(f"{each:g}" for each in gains) + " V/A")


def _dark(session: CheckSession, device: PhotodiodeArray, _subject: str) -> CheckOutcome:
    expected = f"below {100 * DARK_PART:g} % of the range at each gain, no channel far from the others"
    if refusal := _shutter_not_closed(session):
        return not_checked(refusal, expected)
    settings = device.settings
    gains = settings.gains_v_per_a
    largest = abs(float(settings.range.volts(np.array([settings.range.highest]))[0]))
    wrong = []
    volts = EMPTY
    for index, gain in enumerate(gains):
        volts = session.volts(index)
        high = ~(np.abs(volts) <= DARK_PART * largest)
        wrong += [f"{_name(settings, k)} has {volts[k]:.3g} V at {gain:g} V/A" for k in map(int, np.flatnonzero(high))]
    usual = float(np.nanmedian(np.abs(volts)))
    apart = (np.abs(volts) * DARK_RATIO < usual) | (np.abs(volts) > DARK_RATIO * usual)
    wrong += [
        f"{_name(settings, k)} has {volts[k]:.3g} V, the others {usual:.3g} V: dead, not connected, or not in the dark"
        for k in map(int, np.flatnonzero(apart))
    ]
    return judged(not wrong, expected, "; ".join(wrong) or f"median {usual:.3g} V at {gains[-1]:g} V/A")


def _light(session: CheckSession, device: PhotodiodeArray, _subject: str) -> CheckOutcome:
    settings = device.settings
    expected = f"on a white sample each channel sees its part of the light, within {100 * SMOOTH:g} % of its neighbours"
    if refusal := _shutter_not_closed(session):
        return not_checked(refusal, expected)
    if lost := [name for name in POSE_DEG if session.rig.axes[name].unreferenced_reason]:
        return not_checked(f"{' and '.join(lost)} cannot be moved; reference the axes first", expected)
    if not session.mount(WHITE):
        return not_checked("the white standard was not mounted; a person mounts it, in a terminal and without --yes", expected)
    found = {name: session.rig.axes[name].position_deg() for name in POSE_DEG}
    for name, angle in found.items():
        session.rig.axes[name].check_limits(angle)  # else it could not come back
    moved: list[str] = []
    try:
        for name, angle in POSE_DEG.items():
            session.move(name, angle)
            moved.append(name)
    except LimitError as error:  # nothing was sent
        for name in moved:
            session.move(name, found[name])
        return not_checked(str(error), expected)
    signal, noise, gain = _signal(session, settings)
    for name, angle in found.items():
        session.move(name, angle)
    upper = np.arange(settings.count) < len(settings.upper_deg)
    polar = np.radians([*settings.upper_deg, *settings.lower_deg])
    wrong, seeing = [], []
    for arc, of_arc in (("upper", upper), ("lower", ~upper)):
        level = signal[of_arc] / np.cos(polar[of_arc])
        if not of_arc.any() or not np.nanmedian(level) > SEEN * noise:
            continue
        seeing.append(arc)
        offset = int(np.flatnonzero(of_arc)[0])
        wrong += _faults(settings, level, offset)
    if not seeing:
        return not_checked(f"no light reaches the photodiodes at {gain:g} V/A; lamp, wavelength, sample", expected)
    arcs = f"{' and '.join(seeing)} arc at {gain:g} V/A"
    rest = "" if len(seeing) > 1 else "; the other arc sees no light of this sample"
    return judged(not wrong, expected, ("; ".join(wrong) or f"{arcs}: all channels see it") + rest)


def _signal(session: CheckSession, settings: PhotodiodeSettings) -> tuple[Floats, float, float]:
    """Light minus dark (channels,) at the highest gain that is not saturated, V, with its noise and the gain."""
    gains = len(settings.gains_v_per_a)
    with session.open_shutter():
        for gain in reversed(range(gains)):
            light = session.volts(gain)
            if not np.isnan(light).any():
                break
    dark = session.volts(gain)
    noise = max(float(np.nanmedian(np.abs(session.volts(gain) - dark))), settings.range.lsb_v)
    return light - dark, noise, settings.gains_v_per_a[gain]


def _faults(settings: PhotodiodeSettings, level: Floats, offset: int) -> list[str]:
    """What is wrong with the channels of an arc that sees a white sample; `level` is even but for the faults."""
    far = _far(level)
    if not far.any():
        return []
    dead = level < DEAD_PART * float(np.nanmedian(level))
    alive = [int(k) for k in np.flatnonzero(far & ~dead)]
    found = [f"{_name(settings, offset + int(k))} sees no light: dead, not connected or covered" for k in np.flatnonzero(dead)]
    cosines = np.cos(np.radians([*settings.upper_deg, *settings.lower_deg]))[offset : offset + len(level)]
    for a, b in combinations(alive, 2):
        exchanged = level * cosines
        exchanged[[a, b]] = exchanged[[b, a]]
        if not _far(exchanged / cosines)[[a, b]].any():
            found.append(f"{_name(settings, offset + a)} and {_name(settings, offset + b)} are exchanged")
            alive = [k for k in alive if k not in (a, b)]
            break
    return found + [
        f"{_name(settings, offset + k)} differs from its neighbours: gain, angle, or the wire of another channel" for k in alive
    ]


def _far(level: Floats) -> Flags:
    """Which channels (n,) differ from the median of their neighbours, themselves included, or have no value."""
    half = NEIGHBOURS // 2
    first = np.clip(np.arange(len(level)) - half, 0, max(0, len(level) - NEIGHBOURS))
    usual = np.array([np.nanmedian(level[k : k + NEIGHBOURS]) for k in first])
    return np.asarray(~(np.abs(level - usual) <= SMOOTH * np.abs(usual)))


def _shutter_not_closed(session: CheckSession) -> str:
    """Why it is not known to be dark; empty if the shutter is closed. Raises DeviceError."""
    if not session.connected(session.rig.monochromator.name):
        return "the monochromator is not connected, so that its shutter is unknown"
    return "the shutter is open; close it first" if session.rig.monochromator.shutter_is_open() else ""


def _name(settings: PhotodiodeSettings, channel: int) -> str:
    """A channel for people: its module, its channel there, and its place on the arc."""
    upper = len(settings.upper_deg)
    arc, angle = ("upper", settings.upper_deg[channel]) if channel < upper else ("lower", settings.lower_deg[channel - upper])
    module, number = divmod(channel, settings.module_channels)
    return f"channel {channel} (module {module}, input {number}; {arc} arc, {angle:g} deg)"


PHOTODIODE_CHECKS = (
    identity_check("all modules of the rig file"),
    DeviceCheck(
        "identity of each module",
        "the model of the rig file, and its firmware",
        _identity,
        of_each_part=True,
        facts=("40213 and 40214", "Which units it answers"),
    ),
    DeviceCheck("reply times", "all modules within one conversion", _reply_times, of_each_part=True),
    DeviceCheck(
        "ranges and enabled channels read back",
        "the range of the rig file in all channels",
        _settings,
        of_each_part=True,
        facts=("Codes: 0x07",),
    ),
    DeviceCheck(
        "each gain is set and read back",
        "the outputs read back as set",
        _gains,
        facts=("Coils 16 and 17", "Some modules refuse function 16"),
    ),
    DeviceCheck(
        "the dark level of each channel at each gain",
        "below a tenth of the range, no channel far from the others",
        _dark,
        facts=("Twos complement",),
    ),
    DeviceCheck(
        "the light of a white sample on each channel",
        "each channel like its neighbours, over the cosine of its angle",
        _light,
        moves=True,
    ),
)
