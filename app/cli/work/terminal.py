"""The operator at the terminal: questions of a run are printed, and answered by a line."""

import re
import sys
import threading

from goniotwin.app.campaign.running.question import EFFECTS, Answer, PositionGiven, Question, Reply, SampleGiven, answer_of
from goniotwin.app.campaign.schedule.metadata import sample_record
from goniotwin.app.campaign.wording import place_text
from goniotwin.app.cli.output import error_console, print_error
from goniotwin.app.errors import UserError
from goniotwin.app.station.hosting import HostedRun
from goniotwin.app.station.messages import QuestionAsked
from goniotwin.app.toml_file import parse_toml

NO_TERMINAL = "samples are mounted and faults fixed by hand, and standard input is closed; run it in a terminal"
RECORD = '{ thickness_mm = 1.2, note = "..." }'
"""Typed behind Mounted: the record of a sample, as a table of TOML in one line."""
ENCODER = "encoder"
"""Typed in place of an angle: the encoder's."""
Place = tuple[float | None, float | None, bool]
"""Counter and encoder of an axis, deg, as `Snapshot.place` has them."""
NO_PLACE: Place = (None, None, False)


class TerminalAsk:
    """Asks the operator here and at every attached client; the first answer counts."""

    def __init__(self, host: HostedRun) -> None:
        self._host = host
        self._reader: threading.Thread | None = None
        self._question: tuple[int, Question] | None = None
        self._asked = threading.Condition()
        self._closed = False

    def __call__(self, question: Question) -> Reply:
        """Print a question and wait for an answer. Raises UserError where none can come."""

        def note(_number: int, message: object) -> None:
            if isinstance(message, QuestionAsked):
                self._set_question((message.number, message.question))

        if question.axis is not None:
            self._host.station.report_place(question.axis.name)
        _print_question(question, self._place_of(question))
        self._host.station.board.subscribe(note)
        try:
            if self._reader is None:
                self._reader = threading.Thread(target=self._read, name="terminal", daemon=True)
                self._reader.start()
            return self._host.station.ask(question, self._given_up)
        finally:
            self._set_question(None)
            self._host.station.board.unsubscribe(note)

    def _given_up(self) -> str:
        return NO_TERMINAL if self._closed and not self._host.clients else ""

    def _place_of(self, question: Question) -> Place:
        """The axis' counter and encoder now."""
        return self._host.station.snapshot.place(question.axis.name) if question.axis is not None else NO_PLACE

    def _set_question(self, question: tuple[int, Question] | None) -> None:
        with self._asked:
            self._question = question
            self._asked.notify_all()

    def _read(self) -> None:
        """Read answers, one line at a time while a question is open, to the end of standard input."""
        while True:
            with self._asked:
                self._asked.wait_for(lambda: self._question is not None)
                asked = self._question
            line = sys.stdin.readline()
            if not line:
                break
            if asked is None or self._question is not asked:
                continue  # it was answered elsewhere, and the line is no answer to the next one
            place = self._place_of(asked[1])
            found = _reply_of(line, asked[1], place)
            if found is None:
                _print_choices(asked[1], place)
                continue
            self._set_question(None)
            self._answer(asked, found)
        self._closed = True
        self._host.station.wake()

    def _answer(self, asked: tuple[int, Question], reply: Reply) -> None:
        """Answer a question; one that is refused is still open, unless it was answered elsewhere."""
        number, _ = asked
        try:
            angle = reply.angle_deg if isinstance(reply, PositionGiven) else None
            sample = reply.record.given if isinstance(reply, SampleGiven) else None
            self._host.station.answer(number, answer_of(reply), angle, sample)
        except UserError as refusal:
            still = self._host.station.snapshot.question
            if still is not None and still.number == number:
                print_error(refusal)
                self._set_question(asked)


def ask_operator(question: Question) -> Reply:
    """Print a question and read the beginning of an answer. Enter alone is no answer. Raises UserError without a terminal."""
    _print_question(question, NO_PLACE)
    while line := sys.stdin.readline():
        found = _reply_of(line, question, NO_PLACE)
        if found is not None:
            return found
        _print_choices(question, NO_PLACE)
    raise UserError(NO_TERMINAL)


def _answers(question: Question) -> list[Answer]:
    """The answers that a terminal offers."""
    # A pause would last for ever, because a terminal has no Resume; waiting is what a question does by itself.
    return [each for each in question.answers if each not in (Answer.PAUSE, Answer.WAIT)]


def _reply_of(line: str, question: Question, place: Place) -> Reply | None:
    """The reply of a line: the beginning of an answer, and behind Set position an angle, or the word encoder.

    Behind Mounted there may be the record of a sample, as RECORD. Of a wrong one, the error is printed, and it is no reply.
    """
    line, brace, record = line.partition("{")
    if brace:
        if not question.sample or _reply_of(line, question, place) is not Answer.MOUNTED:
            return None
        try:
            return SampleGiven(sample_record(parse_toml(f"sample = {brace}{record}", "sample record")["sample"]))
        except UserError as error:
            print_error(error)
            return None
    words = line.lower().split()
    given = words.pop() if len(words) > 1 and (words[-1] == ENCODER or not words[-1].isalpha()) else ""
    start = " ".join(words)
    found = [each for each in _answers(question) if start and each.lower().startswith(start)]
    if len(found) != 1 or (given != "") is not (found[0] is Answer.SET_POSITION):
        return None
    if not given:
        return found[0]
    if given == ENCODER:
        return None if place[1] is None else PositionGiven(round(place[1], 4))
    number = given.replace("−", "-").replace(",", ".")
    # Not all that Python takes for a number: 1_0 is a slip of the finger.
    return PositionGiven(float(number)) if re.fullmatch(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)", number) else None


def _print_question(question: Question, place: Place) -> None:
    error_console().print(f"{question.title}. {question.text}", style="bold", markup=False)
    for each in _answers(question):
        error_console().print(f"  {each}: {EFFECTS[each]}", markup=False)
    if question.axis is not None or question.sample:
        _print_choices(question, place)


def _print_choices(question: Question, place: Place) -> None:
    """Print what to type; for an axis its counter and encoder now, which may be others than when the question was asked."""
    if question.axis is not None:
        error_console().print(f"{question.axis.name} now: {place_text(*place)}.", markup=False, highlight=False)
    given = "ANGLE" if place[1] is None else f"ANGLE (or {ENCODER})"
    ways = [f"{each} {given}" if each is Answer.SET_POSITION else str(each) for each in _answers(question)]
    if question.sample:
        ways.insert(1, f"{Answer.MOUNTED} {RECORD}")
    error_console().print(f"Type {' or '.join(ways)}, or the beginning of it, then Enter.", markup=False)
