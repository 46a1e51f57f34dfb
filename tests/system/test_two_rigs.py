"""Several virtual rigs in one process."""

from pathlib import Path

from goniotwin.app.campaign.campaign import operator_for
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Event, RowCommitted, State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import Writer


def test_two_virtual_rigs_of_the_same_name_are_independent(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """One campaign runs completely between two rows of another: both journals are those of a campaign alone."""
    plan = make_plan(read_schedule(write_schedule()), read_rig(write_rig()))

    def run(name: str, between: Path | None) -> list[bytes]:
        def listen(event: Event) -> None:
            if between is not None and isinstance(event, RowCommitted) and event.row.number == 3:
                run(between.name, None)

        with open_rig(plan.rig, VirtualClock()) as opened:
            opened.connect()
            with Journal.create(tmp_path / name, plan, {}) as journal:
                engine = Engine(opened.rig, plan, journal, operator_for(opened, plan.rig.file, None), [listen])
                assert engine.run() is State.DONE
                return [
                    reading.counts.tobytes() + str((reading.first_s, reading.monitor_a)).encode()
                    for each in journal.rows()
                    for reading in each.data.readings
                ]

    alone = run("alone", None)
    outer = run("outer", tmp_path / "inner")
    with Journal.open(tmp_path / "inner") as journal:
        inner = [
            reading.counts.tobytes() + str((reading.first_s, reading.monitor_a)).encode()
            for each in journal.rows()
            for reading in each.data.readings
        ]
    assert alone == outer == inner
