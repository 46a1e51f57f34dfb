"""The messages of a station: they survive the channel, and lead to its snapshot."""

from pathlib import Path

import pytest

from goniotwin.app.campaign.running.events import EventLogged, SafetyOrder
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.station.messages import QuestionAsked, Snapshot, advance, decode, encode
from tests.app.station.station_bench import StationBench
from tests.conftest import Writer


def test_every_event_survives_the_channel_and_leads_to_the_same_state(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    """A client that attached at the beginning, and one that attaches at the end, have the snapshot of the station."""
    early = decode(encode(bench.station.snapshot))
    assert isinstance(early, Snapshot)
    bench.events.clear()
    bench.reactions.append(
        lambda message: bench.station.answer(message.number, Answer.MOUNTED) if isinstance(message, QuestionAsked) else None
    )
    bench.station.start(write_schedule(), tmp_path, person=True)
    bench.work()
    bench.station.read()
    bench.work()
    for message in bench.events:
        received = decode(encode(message))
        assert received == message
        assert not isinstance(received, Snapshot)
        assert received is not None
        early = advance(early, received)
    assert early == bench.station.snapshot == decode(encode(bench.station.snapshot))


def test_an_event_of_a_later_version_is_none_and_a_wrong_one_is_an_error() -> None:
    assert decode({"type": "Coffee"}) is None
    with pytest.raises(ValueError, match="Positions"):
        decode({"type": "Positions", "degrees": "all"})
    long = EventLogged("fault", "x" * 100_000)
    assert len(str(encode(long))) < 3000
    assert decode(encode(EventLogged("fault", "what"))) == EventLogged("fault", "what")
    assert decode(encode(SafetyOrder("a", "b"))) == SafetyOrder("a", "b")
