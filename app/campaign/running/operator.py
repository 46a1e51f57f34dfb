"""Operator of a rig: mounts samples and fixes faults. A person at a real rig; at a virtual rig the program, or a person too."""

from collections.abc import Collection
from typing import Protocol

from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.campaign.running.question import (
    Answer,
    Ask,
    FaultReply,
    Question,
    SampleGiven,
    UnreferencedAxis,
    answer_of,
)
from goniotwin.app.campaign.running.stop import Stopped
from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.errors import UserError
from goniotwin.app.rig.lock import check_server
from goniotwin.mocks.control import ControlClient, OrderRefused
from goniotwin.protocols.clock import calendar_stamp
from goniotwin.twin import VirtualRig


class Operator(Protocol):
    """Operator of the rig."""

    def mount(self, sample: str) -> SampleMetadataTable | None:
        """Return when `sample` is in the sample unit; for NO_SAMPLE, when the sample unit is empty. Raises Stopped.

        The record is what a person states of the sample; None of another operator, and of what is no sample of the campaign.
        """

    def resolve_fault(
        self, fault: str, /, *, skippable: bool, device: str = "", axis: UnreferencedAxis | None = None
    ) -> FaultReply | None:
        """Ask for a fault of a device to be fixed; return RETRY, PAUSE, STOP, or, of what is `skippable`, SKIP.

        None: there is no person to ask. Where the fault has left an `axis` unreferenced, the reply may be HOME, if it can home,
        or its position.
        """


class VirtualOperator:
    """Operator of a virtual rig in this process: mounts at once, fixes nothing."""

    def __init__(self, rig: VirtualRig) -> None:
        self._rig = rig

    def mount(self, sample: str) -> None:
        """Mount a sample. Raises KeyError for a sample that the virtual rig does not have."""
        self._rig.mount(None if sample == NO_SAMPLE else sample)

    def resolve_fault(self, _fault: str, /, *, skippable: bool, device: str = "", axis: UnreferencedAxis | None = None) -> None:
        """There is no person to fix a fault."""
        del skippable, device, axis


class ServedOperator:
    """Operator of a virtual rig that another process serves: mounts through the simulation control port, fixes nothing."""

    def __init__(self, port: int, token: str, server: str | None) -> None:
        """`server` is the key of the process that serves the rig, as in `check_server`."""
        self._port, self._token, self._server = port, token, server

    def mount(self, sample: str) -> None:
        """Mount a sample. Raises UserError where the rig is not served any more, or has no such sample."""
        check_server(self._server, f"mounting {sample!r}")
        try:
            control = ControlClient(self._port, self._token)
            try:
                control.do("mount", sample=None if sample == NO_SAMPLE else sample)
            finally:
                control.close()
        except (OSError, OrderRefused) as error:
            raise UserError(
                f"mounting {sample!r} on the served rig: {error}; is `goniotwin serve` still running, with this rig file?"
            ) from None

    def resolve_fault(self, _fault: str, /, *, skippable: bool, device: str = "", axis: UnreferencedAxis | None = None) -> None:
        """There is no person to fix a fault."""
        del skippable, device, axis


class HumanOperator:
    """Person at the rig, asked through `ask`. At a virtual rig `hands` mounts what the person has confirmed.

    `samples` are those of which the person may state a record.
    """

    def __init__(self, ask: Ask, hands: Operator | None = None, samples: Collection[str] = ()) -> None:
        self._ask = ask
        self._hands = hands
        self._samples = samples

    def mount(self, sample: str) -> SampleMetadataTable | None:
        """Ask for a sample to be mounted, or for the sample unit to be emptied. The shutter is closed meanwhile."""
        if sample == NO_SAMPLE:
            title, what = "Empty the sample unit", "Take the sample out, so that the sample unit is empty"
        else:
            title, what = f"Mount {sample}", f"Mount {sample!r} in the sample unit"
        text = f"{what}, then confirm. The shutter is closed."
        answers, recorded = (Answer.MOUNTED, Answer.WAIT, Answer.STOP), sample if sample in self._samples else ""
        reply = self._ask(Question(title, text, answers, Answer.WAIT, sample=recorded))
        if answer_of(reply) is not Answer.MOUNTED:
            raise Stopped
        if self._hands is not None:
            self._hands.mount(sample)
        if not recorded:
            return None
        now = SampleMetadataTable(mounted_at=calendar_stamp())
        return now.updated(reply.record) if isinstance(reply, SampleGiven) else now

    def resolve_fault(
        self, fault: str, /, *, skippable: bool, device: str = "", axis: UnreferencedAxis | None = None
    ) -> FaultReply:
        """Ask for a fault to be fixed."""
        home = (Answer.HOME,) if axis is not None and axis.homes else ()
        here = (Answer.SET_POSITION,) if axis is not None else ()
        skip = (Answer.SKIP,) if skippable else ()
        title = "Device fault" if axis is None else f"Position of {axis.name} unknown"
        answers = (*home, *here, Answer.RETRY, *skip, Answer.PAUSE, Answer.STOP)
        reply = self._ask(Question(title, f"{fault}.", answers, device=device, axis=axis))
        return answer_of(reply) if isinstance(reply, SampleGiven) else reply
