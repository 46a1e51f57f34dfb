"""A jammed axis at a station: home and position are answers of the question, and nothing else moves it."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import EventLogged, RowStarted, State
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.station.messages import QuestionAsked, Snapshot
from goniotwin.app.station.permissions import CommandRefused
from tests.app.campaign.campaign_bench import QUIET
from tests.app.campaign.jam import ASK, AXIS, COUNTED_DEG, HOMES, JAMMED_DEG, check_undisturbed
from tests.app.station.station_bench import StationBench
from tests.conftest import Writer

SHORT = ("angle_deg = -4.0", "angle_deg = -4.0\nlongest_s = 60.0")
"""The search of a jammed axis ends after a minute; from the farthest place it takes half of that."""
Reply = Callable[[StationBench, QuestionAsked], None]


class Jammed:
    """A run on a rig whose arc is jammed while the sample is mounted; each question about it gets the next of `replies`."""

    def __init__(self, bench: StationBench, rig: Path, schedule: Path, folder: Path) -> None:
        self.bench, self.rig, self.schedule, self._folder = bench, rig, schedule, folder
        self.questions: list[QuestionAsked] = []
        self.replies: list[Reply] = []
        bench.reactions.append(self._react)

    def _react(self, message: object) -> None:
        match message:
            case QuestionAsked(number, question) if Answer.MOUNTED in question.answers:
                if "gaussian-5" in question.title:
                    self.jam()
                self.bench.station.answer(number, Answer.MOUNTED)
            case QuestionAsked():
                self.questions.append(message)
                self.replies.pop(0)(self.bench, message)

    def jam(self, jammed: bool = True) -> None:
        self.bench.virtual.plant.shafts[AXIS].jam(self.bench.clock.now(), jammed)

    @property
    def moves(self) -> int:
        return self.bench.virtual.plant.shafts[AXIS].newest.moves

    def run(self, *replies: Reply) -> Snapshot:
        self.replies = list(replies)
        self.bench.station.start(self.schedule, self._folder, person=True)
        return self.bench.work()


@pytest.fixture
def jammed(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> Iterator[Jammed]:
    rig = write_rig(*QUIET, *HOMES, SHORT)
    bench = StationBench(rig)
    yield Jammed(bench, rig, write_schedule(text=ASK), tmp_path / "journals")
    bench.station.close_rig()


def reply(answer: Answer, angle_deg: float | None = None) -> Reply:
    return lambda bench, asked: bench.station.answer(asked.number, answer, angle_deg)


def test_a_homing_that_fails_keeps_the_question_with_the_reason(jammed: Jammed) -> None:
    def free_and_home(bench: StationBench, asked: QuestionAsked) -> None:
        jammed.jam(False)
        bench.station.answer(asked.number, Answer.HOME)

    now = jammed.run(reply(Answer.HOME), free_and_home)
    first, second = (each.question for each in jammed.questions)
    assert first.answers == (Answer.HOME, Answer.SET_POSITION, Answer.RETRY, Answer.SKIP, Answer.PAUSE, Answer.STOP)
    assert "its counter is at 150.000 deg and its encoder at 180.000 deg" in first.text
    assert "goniotwin here" not in first.text  # it would be refused
    assert second.text.startswith("beta: home: ")
    assert first.text in second.text
    assert now.state is State.DONE
    assert now.journal is not None
    check_undisturbed(now.journal, jammed.rig, jammed.schedule)


def test_a_position_is_refused_without_an_angle_and_outside_the_soft_limits_and_the_question_stays(jammed: Jammed) -> None:
    def refused(bench: StationBench, asked: QuestionAsked) -> None:
        for angle_deg, reason in ((None, "give the angle"), (400.0, "soft limits of -5 to 360 deg"), (float("nan"), "nan")):
            with pytest.raises(CommandRefused, match=reason):
                bench.station.answer(asked.number, Answer.SET_POSITION, angle_deg)
            assert bench.station.snapshot.question == asked
        assert bench.station.snapshot.positions[AXIS] == pytest.approx(COUNTED_DEG, abs=0.001)
        assert bench.station.snapshot.encoders[AXIS] == pytest.approx(JAMMED_DEG, abs=0.001)
        commands: tuple[Callable[[], None], ...] = (
            lambda: bench.station.home(AXIS),
            lambda: bench.station.set_position(AXIS, 180.0),
        )
        for command in commands:
            with pytest.raises(CommandRefused, match="Home and Set position are answers of its question"):
                command()
        jammed.jam(False)
        bench.station.answer(asked.number, Answer.SET_POSITION, bench.station.snapshot.encoders[AXIS])

    now = jammed.run(refused)
    assert now.state is State.DONE
    assert now.journal is not None
    check_undisturbed(now.journal, jammed.rig, jammed.schedule)
    with Journal.open(now.journal) as journal:
        assert any("Set position to 180.000 deg" in text for text in journal.event_texts("answer"))


def test_nothing_moves_by_skip_and_the_next_row_asks_again(jammed: Jammed) -> None:
    moves: list[int] = []

    def skip(bench: StationBench, asked: QuestionAsked) -> None:
        moves.append(jammed.moves)
        bench.station.answer(asked.number, Answer.SKIP)

    jammed.bench.reactions.append(lambda message: moves.append(jammed.moves) if isinstance(message, RowStarted) else None)
    now = jammed.run(skip, reply(Answer.STOP))
    assert len(jammed.questions) == 2
    assert moves[-1] == moves[-2]
    assert now.state is State.IDLE
    assert not any("homing" in each.what for each in jammed.bench.events if isinstance(each, EventLogged))
