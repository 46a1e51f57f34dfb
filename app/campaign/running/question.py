"""A question to the operator, its answers and what follows from each. Light: a window needs no driver to show one."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable


class Answer(StrEnum):
    """Answer of the operator to a question."""

    MOUNTED = "Mounted"
    WAIT = "Wait"
    HOME = "Home"
    SET_POSITION = "Set position"
    RETRY = "Retry"
    SKIP = "Skip row"
    PAUSE = "Pause"
    STOP = "Stop"


EFFECTS = {
    Answer.MOUNTED: "The run continues with this sample.",
    Answer.WAIT: "The run waits, with the shutter closed.",
    Answer.HOME: "The axis moves to its reference, and the row is measured again.",
    Answer.SET_POSITION: "The axis is at the angle in the field. Nothing moves now; the row is measured again.",
    Answer.RETRY: "The device is reconnected and the row measured again.",
    Answer.SKIP: "The row stays empty until a resume measures it.",
    Answer.PAUSE: "The run waits; Resume measures the row again.",
    Answer.STOP: "All axes come to rest and the run ends; measured rows stay in the journal.",
}
"""What follows from each answer."""


@dataclass(frozen=True)
class PositionGiven:
    """The answer SET_POSITION, with the angle at which the axis is, deg."""

    angle_deg: float


@dataclass(frozen=True)
class SampleGiven:
    """The answer MOUNTED, with what the operator states of the sample."""

    record: SampleMetadataTable


FaultReply = Answer | PositionGiven
Reply = FaultReply | SampleGiven
"""What a question is answered with: SET_POSITION never without its angle."""


def answer_of(reply: Reply) -> Answer:
    """The answer of a reply, without what was given with it."""
    if isinstance(reply, Answer):
        return reply
    return Answer.SET_POSITION if isinstance(reply, PositionGiven) else Answer.MOUNTED


@dataclass(frozen=True)
class UnreferencedAxis:
    """The axis that a fault has left unreferenced, its soft limits in degrees, and whether it can home."""

    name: str
    lower_deg: float
    upper_deg: float
    homes: bool

    def refusal(self, angle_deg: float) -> str:
        """Why an angle cannot be the position of the axis, in one line; empty if it can."""
        return position_refusal(self.name, self.lower_deg, self.upper_deg, angle_deg)


@dataclass(frozen=True)
class Question:
    """A question to the operator. `default` is the answer to a key that was pressed by accident: it changes nothing.

    `device` is the one that has failed, by its name, or empty; `axis` the one that HOME and SET_POSITION refer to. `sample` is
    the one to be mounted of which a record may be given with MOUNTED; empty of other questions.
    """

    title: str
    text: str
    answers: tuple[Answer, ...]
    default: Answer | None = None
    device: str = ""
    axis: UnreferencedAxis | None = None
    sample: str = ""


def position_refusal(axis: str, lower_deg: float, upper_deg: float, angle_deg: float) -> str:
    """Why an angle cannot be the position of an axis with these soft limits, in one line; empty if it can."""
    if lower_deg <= angle_deg <= upper_deg:  # not so for NaN
        return ""
    return f"{axis} has soft limits of {lower_deg:g} to {upper_deg:g} deg, and {angle_deg:g} deg is outside"


Ask = Callable[[Question], Reply]
"""Function that asks a person a question and returns the reply."""
