"""A question to the operator, its answers and what follows from each. Light: a window needs no driver to show one."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum


class Answer(StrEnum):
    """Answer of the operator to a question."""

    MOUNTED = "Mounted"
    WAIT = "Wait"
    RETRY = "Retry"
    SKIP = "Skip row"
    PAUSE = "Pause"
    STOP = "Stop"


EFFECTS = {
    Answer.MOUNTED: "The run continues with this sample.",
    Answer.WAIT: "The run waits, with the shutter closed.",
    Answer.RETRY: "The device is reconnected and the row measured again.",
    Answer.SKIP: "The row stays empty until a resume measures it.",
    Answer.PAUSE: "The run waits; Resume measures the row again.",
    Answer.STOP: "All axes come to rest and the run ends; measured rows stay in the journal.",
}
"""What follows from each answer."""


@dataclass(frozen=True)
class Question:
    """A question to the operator. `default` is the answer to a key that was pressed by accident: it changes nothing."""

    title: str
    text: str
    answers: tuple[Answer, ...]
    default: Answer | None = None


Ask = Callable[[Question], Answer]
"""Function that asks a person a question and returns the answer."""
