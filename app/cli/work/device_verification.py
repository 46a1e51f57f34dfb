"""`goniotwin verify-device`: the checks of the devices of a rig, what moves nothing first, and their report."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import goniotwin
from goniotwin.app.campaign.campaign import clock_for, operator_for
from goniotwin.app.cli.output import error_console, print_order, print_warning
from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import Replaceable, check_writable, write_file
from goniotwin.app.rig import OpenRig, RigDescription, open_rig, read_rig
from goniotwin.drivers import Device, DeviceError, Rig
from goniotwin.drivers.checks import CheckOutcome, CheckSession, CheckVerdict, DeviceCheck, checks_of
from goniotwin.drivers.checks.check import not_checked
from goniotwin.protocols.clock import calendar_stamp

LOG = logging.getLogger(__name__)
NOT_CONFIRMED = "it moves a device, and the answer was not yes"
NO_TERMINAL = "it moves a device, and there is no terminal to confirm it; run it in one, or give --yes"
YES = "yes"
HEADING = "Verification of the devices of"
REPORT = Replaceable("a report of goniotwin verify-device", lambda content: content.startswith(HEADING.encode()))


@dataclass(frozen=True)
class CheckRecord:
    """The outcome of a check of a device, or of one of its axes or modules (`subject`)."""

    device: str
    subject: str
    check: str
    moves: bool
    outcome: CheckOutcome

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        shown = {"device": self.device, "subject": self.subject, "check": self.check, "moves": self.moves}
        return {**shown, **vars(self.outcome)}

    @property
    def in_one_line(self) -> str:
        """For the log."""
        return " ".join(str(self).split())

    def __str__(self) -> str:
        of = self.device if self.subject == self.device else f"{self.device}, {self.subject}"
        expected = f"\n    expected: {self.outcome.expected}" if self.outcome.expected else ""
        return f"{self.outcome.verdict.value}: {of}: {self.check}{expected}\n    came: {self.outcome.came}"


@dataclass
class VerificationRecord:
    """The outcomes of all checks of a rig, with its identities and the date of the start."""

    rig: str
    simulated: bool
    date: str
    program: str
    identities: dict[str, str] = field(default_factory=dict)
    records: list[CheckRecord] = field(default_factory=list)

    @property
    def differing(self) -> int:
        """Number of checks with a difference."""
        return self._count(CheckVerdict.DIFFERS)

    @property
    def summary(self) -> str:
        """The numbers of verdicts."""
        simulated = "SIMULATED: " if self.simulated else ""
        return simulated + ", ".join(f"{self._count(each)} {each.value}" for each in CheckVerdict)

    @property
    def text(self) -> str:
        """The report."""
        marked = " (SIMULATED)" if self.simulated else ""
        head = [f"{HEADING} {self.rig}{marked}", f"{self.date}, {self.program}", ""]
        head += [f"{name}: {identity}" for name, identity in self.identities.items()]
        return "\n".join([*head, "", *map(str, self.records), "", self.summary, ""])

    def _count(self, verdict: CheckVerdict) -> int:
        return sum(each.outcome.verdict is verdict for each in self.records)


def verify_devices(
    path: Path, names: list[str], *, yes: bool, report: Path | None, transcript: Path | None, quiet: bool
) -> VerificationRecord:
    """Check devices, by the names of `goniotwin devices` or of axes; all without names. What moves waits for a yes.

    Outcomes are printed as they come unless `quiet`. Raises UserError.
    """
    if report is not None:
        check_writable(report, REPORT)
    description = read_rig(path)
    program = f"goniotwin {goniotwin.__version__}"
    result = VerificationRecord(description.file.name, description.simulated, calendar_stamp(), program)
    with open_rig(description, clock_for(description.file), transcript) as opened:
        chosen = _chosen(path, opened.rig, names)
        if (left := opened.guard.left) is not None and not left.done:
            print_order(left.text)

        def note(device: Device, subject: str, check: DeviceCheck, outcome: CheckOutcome) -> None:
            result.records.append(CheckRecord(device.name, subject, check.what, check.moves, outcome))
            LOG.info("%s", result.records[-1].in_one_line)
            if not quiet:
                print(result.records[-1], flush=True)

        session = CheckSession(opened.rig, _no_answer if yes else _ask, _mount(description, opened, yes=yes))
        with _closed_shutter(session), _stopped_on_interrupt(opened.rig):  # the axes first
            errors = opened.rig.connect()
            result.identities.update(opened.rig.identities)
            _check_all(session, chosen, errors, lambda: yes or _confirmed(chosen), note)
        if (incomplete := opened.transcript_failure) is not None:
            print_warning(incomplete)
    if report is not None:
        write_file(report, result.text.encode(), REPORT)
    return result


Chosen = dict[str, tuple[Device, frozenset[str]]]
"""Devices to be checked, and those of their axes or modules; by name."""
Note = Callable[[Device, str, DeviceCheck, CheckOutcome], None]


def _chosen(path: Path, rig: Rig, names: list[str]) -> Chosen:
    """The devices of names, beginnings of names ("mono") included. Raises UserError."""
    chosen: Chosen = {}
    known = [each.name for each in rig.devices] + [each for each in rig.axes if each not in {one.name for one in rig.devices}]
    for name in names or [each.name for each in rig.devices]:
        found = [name] if name in known else [each for each in known if each.startswith(name)]
        if len(found) != 1 or not name:
            raise UserError(f"{path}: {name!r} is no device of this rig; give {', '.join(known)}")
        device = rig.device(found[0])
        parts = frozenset(device.parts) if found[0] == device.name else frozenset(found)
        _, before = chosen.get(device.name, (device, frozenset[str]()))
        chosen[device.name] = (device, before | parts)
    return chosen


def _check_all(
    session: CheckSession,
    chosen: Chosen,
    errors: dict[str, DeviceError | None],
    confirm: Callable[[], bool],
    note: Note,
) -> None:
    """Carry out all checks: what moves nothing of all devices, then what moves. Nothing moves an axis that differs."""
    differing: set[str] = set()
    confirmed: bool | None = None
    for moves in (False, True):
        for device, parts in chosen.values():
            first = True
            for check in (each for each in checks_of(session.rig, device) if each.moves is moves):
                for subject in (each for each in check.subjects(device) if each == device.name or each in parts):
                    error = errors[device.name]
                    if error is not None:
                        fault = CheckOutcome(CheckVerdict.DIFFERS, check.expected, str(session.rig.in_words(error)))
                        outcome = fault if first and not moves else not_checked("it is not connected")
                    elif moves and subject in differing:
                        outcome = not_checked("an earlier check of this axis differs; correct that first")
                    else:
                        if moves and confirmed is None:
                            confirmed = confirm()
                        outcome = check.outcome(session, device, subject) if confirmed or not moves else _not_confirmed()
                    first = False
                    if outcome.verdict is CheckVerdict.DIFFERS and subject in session.rig.axes:
                        differing.add(subject)
                    note(device, subject, check, outcome)


@contextmanager
def _stopped_on_interrupt(rig: Rig) -> Iterator[None]:
    """Stop all axes on Ctrl-C, and after any error."""
    try:
        yield
    except BaseException:
        for failure in rig.stop():
            print_order(str(rig.in_words(failure)))
        raise


@contextmanager
def _closed_shutter(session: CheckSession) -> Iterator[None]:
    """Close the shutter at the end if the checks have opened it, also after a fault or a stop."""
    try:
        yield
    finally:
        try:
            session.close_shutter()
        except DeviceError as error:
            print_order(f"close the shutter by hand: {session.rig.in_words(error)}")


def _mount(description: RigDescription, opened: OpenRig, *, yes: bool) -> Callable[[str], bool]:
    """Has a sample mounted: by the program in a virtual rig, else by a person; False without either."""

    def mount(sample: str) -> bool:
        if description.simulated:
            try:
                operator_for(opened, description.file, None).mount(sample)
            except (KeyError, UserError):
                return False
            return True
        answer = None if yes else _ask(f"mount the white standard in the sample unit, then type yes ({sample})")
        return answer is not None and answer.lower() == YES

    return mount


def _confirmed(chosen: Chosen) -> bool:
    """Ask whether what follows may move."""
    what = [f"{name} ({', '.join(sorted(parts))})" if parts else name for name, (_, parts) in chosen.items()]
    danger = "keep away from the arc and the sample unit, and have the main switch within reach"
    answer = _ask(f"the following checks move: {', '.join(what)}; {danger}. Type yes to go on")
    return answer is not None and answer.lower() == YES


def _ask(question: str) -> str | None:
    """A line of the person at the terminal; None without one, and for an empty line."""
    if not sys.stdin.isatty():
        return None
    error_console().print(f"{question}: ", end="", markup=False)
    return sys.stdin.readline().strip() or None


def _not_confirmed() -> CheckOutcome:
    return not_checked(NOT_CONFIRMED if sys.stdin.isatty() else NO_TERMINAL)


def _no_answer(_question: str) -> str | None:
    return None
