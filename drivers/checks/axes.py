"""Checks of motion controllers and their axes."""

from goniotwin.drivers.checks.check import CheckOutcome, CheckSession, DeviceCheck, identity_check, judged, not_checked
from goniotwin.drivers.errors import DeviceError, LimitError
from goniotwin.drivers.motion.axis import Axis, limit_violation
from goniotwin.drivers.motion.controller import MotionController
from goniotwin.drivers.motion.tmcl import TmclController
from goniotwin.drivers.motion.tmcl.axis import TmclAxis
from goniotwin.protocols.tmcl import Command, CommandFrame
from goniotwin.protocols.tmcl_parameters import GlobalParameter

SMALL_MOVE_DEG = 5.0
LONGER_MOVE_DEG = 20.0
STOP_FRAMES_S = 0.2
"""The stop frames of all axes are on their wires by then, and confirmed."""
POLL_S = 0.02
LATE_S = 0.3
"""What the exchanges of a move or of a stop may add to its ramp."""
DURATION = 0.15
"""Largest relative difference of a move's duration from its estimate."""
SCALE_TOLERANCE_DEG = 0.5
STILL_DEG = 0.01
STOPPED_PART = 0.6
"""Part of a move at which an axis must be at rest that was stopped after a quarter of its time; in theory one half at most."""


def _encoder_tolerance_deg(axis: Axis) -> float:
    limit: float = getattr(axis.settings, "tolerance_deg", 0.0) or SCALE_TOLERANCE_DEG
    return limit


def _settings(_session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    axis = controller.axes[subject]
    if not isinstance(axis, TmclAxis):
        return not_checked("its driver has no list of its settings")
    parameters = axis.parameters()
    wrong = [
        f"{parameter.name.lower()} ({parameter.value}) is {now} instead of {value}"
        for parameter, value in parameters
        if (now := axis.read_parameter(parameter)) != value
    ]
    return judged(not wrong, f"{len(parameters)} axis parameters of the rig file", "; ".join(wrong) or "the same values")


def _heartbeat(_session: CheckSession, controller: MotionController, _subject: str) -> CheckOutcome:
    if not isinstance(controller, TmclController):
        return not_checked("its driver does not show its heartbeat")
    wanted = round(1e3 * controller.module.heartbeat_s)
    found = {
        address: controller.module.exchange(CommandFrame(address, Command.GGP, GlobalParameter.HEARTBEAT, 0))
        for address in sorted({axis.settings.module for axis in controller.axes.values()})
    }
    came = ", ".join(f"{value} ms in module {address}" for address, value in found.items())
    return judged(set(found.values()) == {wanted}, f"global parameter 68 is {wanted} ms", came)


def _reply_times(session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    longest_s = 2.0 * controller.module.timeout_s if isinstance(controller, TmclController) else 1.0
    return session.reply_times(controller.axes[subject].position_deg, longest_s)


def _switches(_session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    axis = controller.axes[subject]
    if not isinstance(axis, TmclAxis):
        return not_checked("its driver does not show its switches")
    switches, errors, driver = axis.switches(), axis.read_errors(), axis.driver_flags()
    on = [name for name in ("left", "right") if axis.settings.switches and getattr(switches, name)]
    came = [f"the {name} limit switch is active" for name in on]
    came += [f"error flags {errors!s}"] if errors else []
    faults = driver & ~(type(driver).STANDSTILL | type(driver).OVERTEMPERATURE_WARNING)
    came += [f"driver flags {faults!s}"] if faults else []
    return judged(not came, "no limit switch active, no error flag", "; ".join(came) or "none")


def _connected_again(session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    axis = controller.axes[subject]
    before = axis.position_deg(), axis.unreferenced_reason
    session.rig.reconnect(controller.name)
    after = axis.position_deg(), axis.unreferenced_reason
    still = not axis.is_moving() and abs(after[0] - before[0]) <= STILL_DEG and after[1] == before[1]
    expected = "it stands still, and is referenced or not as before"
    reason = f"; {after[1]}" if after[1] != before[1] else ""
    return judged(still, expected, f"{before[0]:.3f} deg, connected again {after[0]:.3f} deg{reason}")


def _encoder(_session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    axis = controller.axes[subject]
    if not axis.settings.encoder:
        return not_checked("the rig file states no encoder; read its scale")
    counter, encoder = axis.position_deg(), axis.encoder_deg()
    if axis.unreferenced_reason or encoder is None:
        shown = "lost in a reset" if encoder is None else f"{encoder:.3f} deg"
        return not_checked(f"{_unreferenced(axis)}; counter {counter:.3f} deg, encoder {shown}")
    limit = _encoder_tolerance_deg(axis)
    came = f"counter {counter:.3f} deg, encoder {encoder:.3f} deg"
    return judged(abs(encoder - counter) <= limit, f"they agree within {limit:g} deg", came)


def _limits(_session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    axis = controller.axes[subject]
    lower, upper = axis.settings.lower_deg, axis.settings.upper_deg
    accepted = []
    for target in (lower - 1.0, upper + 1.0):
        try:
            axis.check_limits(target)
            accepted.append(f"{target:g} deg is accepted")
        except LimitError:
            pass
    here = axis.position_deg()
    if not lower - STILL_DEG <= here <= upper + STILL_DEG:
        accepted.append(f"it is at {here:.3f} deg already")
    expected = f"moves beyond {lower:g} and {upper:g} deg are refused, and it is between them"
    return judged(not accepted, expected, "; ".join(accepted) or f"refused; it is at {here:.3f} deg")


def _there_and_back(session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    axis = controller.axes[subject]
    if reason := _unreferenced(axis):
        return not_checked(reason)
    start_deg = axis.position_deg()
    encoder_start = axis.encoder_deg()
    target = _target(axis, start_deg, SMALL_MOVE_DEG)
    expected = f"from {start_deg:.3f} to {target:.3f} deg and back in the estimated time" + (
        ", the encoder with the counter" if encoder_start is not None else ""
    )
    try:
        durations, differences = [], list[float]()
        for end in (target, start_deg):
            begun = session.rig.clock.now()
            pending = session.rig.start(subject, end)
            estimated = pending.arrival - begun
            session.wait(pending)
            durations.append((session.rig.clock.now() - begun, estimated))
            session.rig.clock.sleep_until(session.rig.clock.now() + axis.settings.settling_s)
            here, encoder = axis.read_back()
            differences += [abs(encoder - here)] if encoder is not None else []
            if abs(here - end) > STILL_DEG:
                return judged(False, expected, f"it is at {here:.3f} deg instead of {end:.3f} deg")
    except LimitError:
        raise
    except DeviceError as error:
        return judged(False, expected, f"{session.rig.in_words(error)}{_contradiction(axis, start_deg, encoder_start)}")
    good = all(abs(took - estimated) <= DURATION * estimated + LATE_S for took, estimated in durations)
    came = " and ".join(f"{took:.2f} s (estimated {estimated:.2f} s)" for took, estimated in durations)
    apart = f", encoder and counter at most {max(differences):.3f} deg apart" if differences else ""
    return judged(good, expected, came + apart)


def _contradiction(axis: Axis, start_deg: float, encoder_start: float | None) -> str:
    """What counter and encoder show after a failed move, and what that means; empty without an encoder."""
    if encoder_start is None:
        return ""
    try:
        counter, encoder = axis.position_deg() - start_deg, (axis.encoder_deg() or 0.0) - encoder_start
    except DeviceError:
        return ""
    if abs(encoder - counter) <= _encoder_tolerance_deg(axis):
        return ""
    turned = f"; the counter turned {counter:.3f} deg and the encoder {encoder:.3f} deg"
    if abs(encoder) < 0.1 * abs(counter):
        return f"{turned}: the encoder does not count, or the axis does not turn"
    if encoder * counter < 0.0:
        return f"{turned}: the encoder counts the other way"
    return f"{turned}: gear, full_steps or encoder_counts of the rig file are wrong by the factor {counter / encoder:.4g}"


def _stop(session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    axis, clock = controller.axes[subject], session.rig.clock
    if reason := _unreferenced(axis):
        return not_checked(reason)
    start_deg = axis.position_deg()
    target = _target(axis, start_deg, LONGER_MOVE_DEG)
    begun = clock.now()
    pending = session.rig.start(subject, target)
    duration = pending.arrival - begun
    while clock.now() < begun + 0.25 * duration:
        clock.sleep_until(min(clock.now() + 5.0 * POLL_S, begun + 0.25 * duration))
        axis.is_moving()
    stopped = clock.now()
    failures = [each for each in session.rig.stop() if each.device in (subject, controller.name)]
    confirmed_s = clock.now() - stopped
    longest_s = 0.25 * duration + LATE_S
    while axis.is_moving() and clock.now() < stopped + duration + LATE_S:
        clock.sleep_until(clock.now() + POLL_S)
    rest_s, rest = clock.now() - stopped, axis.position_deg()
    expected = f"stop confirmed within {STOP_FRAMES_S:g} s, at rest within {longest_s:.2f} s, short of {target:.3f} deg"
    came = f"confirmed after {confirmed_s:.3f} s, at rest after {rest_s:.2f} s at {rest:.3f} deg"
    if failures or axis.is_moving():
        session.rig.stop()
        reason = str(session.rig.in_words(failures[0])) if failures else f"it still turns after {rest_s:.2f} s"
        return judged(False, expected, f"{reason}; cut the motors' power")
    part = (rest - start_deg) / (target - start_deg)
    if part > STOPPED_PART or rest_s > longest_s or confirmed_s > STOP_FRAMES_S:
        return judged(False, expected, f"{came}: the axis does not stop on request")
    session.move(subject, start_deg)
    return judged(True, expected, came)


def _scale(session: CheckSession, controller: MotionController, subject: str) -> CheckOutcome:
    axis = controller.axes[subject]
    if reason := _unreferenced(axis):
        return not_checked(reason)
    start_deg = axis.position_deg()
    target = _target(axis, start_deg, LONGER_MOVE_DEG)
    first = _read_scale(session, subject)
    if first is None:
        return not_checked("its scale was not read; a person reads it, in a terminal and without --yes")
    session.move(subject, target)
    second = _read_scale(session, subject)
    session.move(subject, start_deg)
    if second is None:
        return not_checked("its scale was not read")
    turned = second - first
    expected = f"the scale shows {start_deg:.2f}, then {target:.2f} deg (within {SCALE_TOLERANCE_DEG:g} deg)"
    came = f"{first:g}, then {second:g} deg"
    if turned * (target - start_deg) < 0.0:
        came += ": the axis turns the other way: exchange the sign of sense"
    elif abs(turned - (target - start_deg)) > SCALE_TOLERANCE_DEG and turned:
        came += f": gear or full_steps are wrong by the factor {(target - start_deg) / turned:.4g}"
    good = abs(first - start_deg) <= SCALE_TOLERANCE_DEG and abs(second - target) <= SCALE_TOLERANCE_DEG
    return judged(good, expected, came)


def _read_scale(session: CheckSession, axis: str) -> float | None:
    answer = session.ask(f"{axis}: read its scale, in degrees (an empty line: it cannot be read)")
    try:
        return None if answer is None else float(answer)
    except ValueError:
        return None


def _target(axis: Axis, start_deg: float, distance_deg: float) -> float:
    """Where a move over a distance leads, in the direction that the soft limits allow; over less where both are too near.

    Raises LimitError where the axis could not come back: against backlash it arrives from one side only.
    """
    axis.check_limits(start_deg)
    for part in (1.0, 0.5, 0.25, 0.1):
        for target in (start_deg + part * distance_deg, start_deg - part * distance_deg):
            if limit_violation(axis.settings, target) is None:
                return target
    raise LimitError(axis.name, "choose a small move", "its soft limits leave no room", "correct the limits in the rig file")


def _unreferenced(axis: Axis) -> str:
    """Why an axis cannot be moved to an angle; empty if it can."""
    if not axis.unreferenced_reason:
        return ""
    way = "goniotwin home" if axis.settings.homing is not None else "goniotwin here"
    return f"unreferenced: {axis.unreferenced_reason}; reference it first: {way}"


AXIS_CHECKS = (
    identity_check("TMCM-6214 or TMCM-1240, at the module addresses of the rig file"),
    DeviceCheck(
        "the axis parameters that the driver writes read back",
        "the values of the rig file",
        _settings,
        of_each_part=True,
        facts=("14, 24 to 26, 127, 204, 214, 251",),
    ),
    DeviceCheck(
        "the heartbeat of each module",
        "global parameter 68 has the rig file's heartbeat_s",
        _heartbeat,
    ),
    DeviceCheck("reply times", "within two reply timeouts (two attempts)", _reply_times, of_each_part=True),
    DeviceCheck(
        "switches and flags at rest",
        "no limit switch active, no error flag",
        _switches,
        of_each_part=True,
    ),
    DeviceCheck(
        "connected again",
        "the same position, referenced or not as before",
        _connected_again,
        of_each_part=True,
        facts=("Writing the same microstep resolution",),
    ),
    DeviceCheck(
        "encoder against counter at rest",
        "they agree",
        _encoder,
        of_each_part=True,
        facts=("209 is in microsteps", "210 is counts a motor turn"),
    ),
    DeviceCheck("targets beyond the soft limits", "refused, nothing is sent", _limits, of_each_part=True),
    DeviceCheck(
        "a small move there and back: time, counter, encoder",
        "the estimated time, and the encoder follows the counter",
        _there_and_back,
        moves=True,
        of_each_part=True,
        facts=("209 is in microsteps", "210 is counts a motor turn", "255 = 0"),
    ),
    DeviceCheck(
        "a stop in the middle of a move",
        "confirmed within 0.2 s, at rest after the ramp, short of the target",
        _stop,
        moves=True,
        of_each_part=True,
    ),
    DeviceCheck(
        "the scale before and after a move",
        "it shows the angles of the counter",
        _scale,
        moves=True,
        of_each_part=True,
    ),
)
