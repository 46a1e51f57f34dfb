"""The questions of a run at a station: the first answer counts, and the journal keeps the person that mounts."""

from pathlib import Path

from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.station.messages import Message, QuestionAsked, QuestionClosed
from goniotwin.app.station.permissions import CommandRefused
from tests.app.campaign.campaign_bench import QUIET
from tests.app.station.station_bench import StationBench
from tests.conftest import Writer


def test_a_person_mounts_and_the_first_answer_counts(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    refused: list[str] = []

    def react(message: Message) -> None:
        if isinstance(message, QuestionAsked):
            bench.station.answer(message.number, Answer.WAIT)
            bench.station.answer(message.number, Answer.MOUNTED)
            for number, choice in ((message.number, Answer.MOUNTED), (message.number + 1, Answer.MOUNTED)):
                try:
                    bench.station.answer(number, choice)
                except CommandRefused as error:
                    refused.append(str(error))

    bench.reactions.append(react)
    bench.station.start(write_schedule(), tmp_path, person=True)
    assert bench.work().state is State.DONE
    asked = bench.of(QuestionAsked)
    assert [each.question.title for each in asked] == ["Mount etalon", "Mount gaussian-5"]  # type: ignore[union-attr]
    assert len(refused) == 2 * len(asked)
    assert all("is answered already" in each for each in refused)
    assert [each.answer for each in bench.of(QuestionClosed)] == [Answer.MOUNTED] * 2  # type: ignore[union-attr]


def test_a_resumed_run_has_the_operator_that_it_began_with(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, write_rig: Writer
) -> None:
    """The choice is in the journal: the station that began it, and its window, may be gone."""
    answer = Answer.STOP

    def react(message: Message) -> None:
        if isinstance(message, QuestionAsked):
            (bench if len(asked) == 0 else other).station.answer(message.number, answer)
            asked.append(message)

    asked: list[QuestionAsked] = []
    bench.reactions.append(react)
    bench.station.start(write_schedule(), tmp_path, person=True)
    now = bench.work()
    assert (now.state, now.person, len(asked)) == (State.IDLE, True, 1)
    bench.station.close_rig()
    other = StationBench(write_rig(*QUIET))
    other.reactions.append(react)
    answer = Answer.MOUNTED
    assert now.journal is not None
    other.station.resume_journal(now.journal)
    now = other.work()
    assert (now.state, now.person, len(asked)) == (State.DONE, True, 3)
    other.station.close_rig()


def test_stop_answers_a_question(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    bench.reactions.append(
        lambda message: bench.station.answer(message.number, Answer.STOP) if isinstance(message, QuestionAsked) else None
    )
    bench.station.start(write_schedule(), tmp_path, person=True)
    now = bench.work()
    assert now.state is State.IDLE
    assert now.question is None
