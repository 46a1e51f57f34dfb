"""Safety orders of a station: how long they stand, and when a shutter that is found open is one."""

from pathlib import Path

import pytest

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import EventLogged, SafetyOrder
from goniotwin.app.guardian.record import Record
from goniotwin.app.station.bench import Bench
from goniotwin.app.station.messages import Message, OrderAcknowledged, RowSaved
from goniotwin.app.station.permissions import CommandRefused
from goniotwin.drivers import Rig
from goniotwin.drivers.errors import NoAnswer
from goniotwin.drivers.guard import CLOSE_SHUTTER
from tests.app.campaign.campaign_bench import QUIET
from tests.app.station.station_bench import StationBench
from tests.conftest import Writer


def test_an_order_stands_until_it_is_acknowledged(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.station.start(write_schedule(), tmp_path)
    bench.clock.at(bench.clock.now() + 8.0, bench.station.stop)
    with monkeypatch.context() as patch:
        patch.setattr(Rig, "stop", lambda _rig: [NoAnswer("sigma", "MST", "nothing")])
        now = bench.work()
    (order,) = now.orders
    assert now.journal is not None
    assert campaign_summary(now.journal).orders == [order.text]
    with pytest.raises(CommandRefused, match="no such safety order"):
        bench.station.acknowledge("something else")
    bench.station.acknowledge(order.text)
    assert bench.station.snapshot.orders == ()
    assert campaign_summary(now.journal).orders == []
    with pytest.raises(CommandRefused, match="no safety order is open"):
        bench.station.acknowledge(order.text)


def test_an_order_about_the_shutter_ends_when_the_run_has_seen_it_closed(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    order = SafetyOrder(CLOSE_SHUTTER, "it may be open")
    open_orders: list[tuple[SafetyOrder, ...]] = []

    def give(message: Message) -> None:
        if isinstance(message, RowSaved) and message.row.kind == "measure" and order not in bench.events:
            bench.station.runs.listen(order)
            open_orders.append(bench.station.snapshot.orders)

    bench.reactions.append(give)
    bench.station.start(write_schedule(), tmp_path)
    now = bench.work()
    assert open_orders == [(order,)]
    kinds = [type(each) for each in bench.events]
    assert kinds.index(OrderAcknowledged) < max(k for k, kind in enumerate(kinds) if kind is RowSaved)
    assert now.orders == ()


def test_an_order_of_the_last_session_stands_after_a_resume(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, write_rig: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.station.start(write_schedule(), tmp_path)
    bench.clock.at(bench.clock.now() + 8.0, bench.station.stop)
    with monkeypatch.context() as patch:
        patch.setattr(Rig, "stop", lambda _rig: [NoAnswer("sigma", "MST", "nothing")])
        journal = bench.work().journal
    assert journal is not None
    other = StationBench(write_rig(*QUIET))
    other.station.resume_journal(journal)
    (order,) = other.work().orders
    assert order.order == "Cut the motors' power"
    other.station.acknowledge(order.text)
    assert campaign_summary(journal).orders == []
    other.station.close_rig()


@pytest.mark.parametrize("closed", [True, False])
def test_an_order_in_the_journal_of_an_earlier_program_ends_with_what_that_has_left(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, closed: bool
) -> None:
    """Its run could not close the shutter. This program sees it closed, or a person acknowledges the order to close it."""
    bench.station.start(write_schedule(), tmp_path)
    bench.clock.at(bench.clock.now() + 8.0, bench.station.stop)
    journal = bench.work().journal
    assert journal is not None
    with Journal.reopen(journal) as reopened:
        reopened.event(9.0, "order", f"{CLOSE_SHUTTER}: it may be open")
        reopened.event(9.0, "order", "Cut the motors' power: beta")
    guard = bench.opened.guard.device("left-in-a-test", "socket://127.0.0.1:1")
    about = ("rig", 4711, "2026-01-01T00:00:00+00:00", str(guard.path), str(journal), (), ())
    guard.left = Record(
        "monochromator", "socket://127.0.0.1:1", 9600, "", "", "", "", "it may be open", CLOSE_SHUTTER, "", *about
    )
    assert len(campaign_summary(journal).orders) == 2

    def fail(_bench: Bench) -> None:
        raise NoAnswer("monochromator", "SHUTTER C", "not responding")

    if not closed:
        bench.virtual.plant.shutter_open.set(bench.clock.now(), True)
        monkeypatch.setattr(Bench, "close_left_open", fail)
    bench.station.connect("monochromator")
    orders = bench.work().orders
    assert len(orders) == (0 if closed else 1)
    for each in orders:
        assert len(campaign_summary(journal).orders) == 2
        bench.station.acknowledge(each.text)
    assert campaign_summary(journal).orders == ["Cut the motors' power: beta"]


def test_an_order_without_a_run(bench: StationBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Rig, "stop", lambda _rig: [NoAnswer("beta", "MST", "nothing")])
    (failure,) = bench.station.stop()
    assert failure.startswith("beta: MST: nothing")
    (order,) = bench.station.snapshot.orders
    bench.station.acknowledge(order.text)
    assert bench.station.snapshot.orders == ()


def test_a_shutter_that_is_found_open_is_an_order_until_it_is_closed(bench: StationBench) -> None:
    """Opened by hand, or by another program: it is left as it is, because a person may work with it."""
    bench.virtual.plant.shutter_open.set(bench.clock.now(), True)
    bench.station.connect("monochromator")
    (order,) = bench.work().orders
    assert order.order == "Close the shutter by hand"
    assert bench.virtual.plant.shutter_open.at(bench.clock.now())
    bench.station.shutter(opened=False)
    assert bench.work().orders == ()
    assert bench.station.orders.open == []


def test_a_shutter_that_the_bench_has_opened_is_no_order(bench: StationBench) -> None:
    bench.station.shutter(opened=True)
    bench.work()
    bench.station.connect("monochromator")
    assert bench.work().orders == ()
    bench.station.shutter(opened=False)
    bench.work()


def test_a_run_closes_a_shutter_that_is_found_open(write_rig: Writer) -> None:
    bench = StationBench(write_rig(*QUIET))
    bench.virtual.plant.shutter_open.set(bench.clock.now(), True)
    bench.station.report_connected()  # as of `goniotwin run`
    assert bench.station.orders.open == []
    assert not bench.virtual.plant.shutter_open.at(bench.clock.now())
    assert [each.what for each in bench.events if isinstance(each, EventLogged)][-1].startswith(
        "Shutter closed now: it is open"
    )
    bench.station.close_rig()
