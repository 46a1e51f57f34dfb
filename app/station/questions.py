"""The questions of a run to its operator: asked in the engine's thread, answered from any; the first answer counts."""

import queue
import threading
from collections.abc import Callable, Mapping
from typing import Any

from goniotwin.app.campaign.running.question import Answer, PositionGiven, Question, Reply, SampleGiven, answer_of
from goniotwin.app.campaign.schedule.metadata import sample_record
from goniotwin.app.errors import UserError
from goniotwin.app.station.board import Board
from goniotwin.app.station.messages import QuestionAsked, QuestionClosed
from goniotwin.app.station.permissions import CommandRefused

LOOK_S = 1.0
"""Real time between two looks at the devices while a question waits."""


class Questions:
    """The question that is open, by its number, and its answer. A stop, which sets `stopped`, answers each."""

    def __init__(self, board: Board, stopped: threading.Event, look_s: float = LOOK_S) -> None:
        self._board = board
        self._stopped, self._look_s = stopped, look_s
        self._asked = 0
        self._answered = 0
        self._answers: queue.SimpleQueue[tuple[int, Reply] | None] = queue.SimpleQueue()

    def ask(self, question: Question, look: Callable[[], None], given_up: Callable[[], str]) -> Reply:
        """Wait for the operator's answer, or for a stop. Raises UserError with the reason where `given_up` has one.

        `look` is called before a question about an axis, which a person may turn, and again and again while any waits.
        """
        self._asked += 1
        number: int = self._asked
        given: Answer | None = None
        if self._stopped.is_set():
            return Answer.STOP
        if question.axis is not None:
            look()
        self._board.publish(QuestionAsked(number, question))
        try:
            while not self._stopped.is_set():
                if self._answers.empty() and (reason := given_up()):
                    raise UserError(reason)
                try:
                    answer = self._answers.get(timeout=self._look_s)
                except queue.Empty:
                    look()
                    continue
                if answer is not None and answer[0] == number:
                    given = answer_of(answer[1])
                    return answer[1]
            return Answer.STOP
        finally:
            self._board.publish(QuestionClosed(number, given))

    def answer(
        self, number: int, choice: Answer, angle_deg: float | None = None, sample: Mapping[str, Any] | None = None
    ) -> None:
        """Take an answer to the open question, which `Wait` leaves open, as `Stop` does until the stop itself ends it.

        `sample` has the keys and values of a record, see `sample_record`. Raises CommandRefused.
        """
        try:
            record = sample_record(sample) if sample else None
        except UserError as error:
            raise CommandRefused(str(error)) from None
        with self._board.deciding() as now:
            asked = now.question
            if asked is None or asked.number != number or self._answered == number:
                raise CommandRefused(f"question {number} is answered already")
            if choice not in asked.question.answers:
                raise CommandRefused(f"{choice}: is no answer to this question; give {' or '.join(asked.question.answers)}")
            reply: Reply = choice
            if choice is Answer.SET_POSITION and (axis := asked.question.axis) is not None:
                if angle_deg is None:
                    raise CommandRefused(f"{choice}: give the angle at which {axis.name} is, in degrees")
                if refusal := axis.refusal(angle_deg):
                    raise CommandRefused(refusal)
                reply = PositionGiven(angle_deg)
            if record is not None:
                if choice is not Answer.MOUNTED or not asked.question.sample:
                    raise CommandRefused(f"{choice}: takes no record of a sample; leave it out")
                reply = SampleGiven(record)
            if choice in (Answer.WAIT, Answer.STOP):
                return
            self._answered = number
        self._answers.put((number, reply))

    def wake(self) -> None:
        """Let `ask` look at a stop, and at its `given_up`."""
        self._answers.put(None)
