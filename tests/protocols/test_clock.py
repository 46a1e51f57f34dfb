"""Clocks: the virtual one jumps, the real one runs."""

import threading
from datetime import datetime

import pytest

from goniotwin.protocols.clock import RealClock, VirtualClock, local_stamp


def test_a_virtual_clock_jumps_and_never_goes_back() -> None:
    clock = VirtualClock()
    clock.sleep_until(5.0)
    clock.sleep_until(3.0)
    assert clock.now() == 5.0


def test_events_happen_on_the_way_in_the_order_of_their_times() -> None:
    clock = VirtualClock()
    seen: list[tuple[str, float]] = []
    clock.at(2.0, lambda: seen.append(("second", clock.now())))
    clock.at(1.0, lambda: seen.append(("first", clock.now())))
    clock.at(9.0, lambda: seen.append(("later", clock.now())))
    clock.sleep_until(3.0)
    assert seen == [("first", 1.0), ("second", 2.0)]


def test_an_action_may_sleep_and_the_sleeper_then_wakes_late() -> None:
    clock = VirtualClock()
    clock.at(1.0, lambda: clock.sleep_until(4.0))
    clock.sleep_until(2.0)
    assert clock.now() == 4.0


def test_a_cancelled_event_does_not_happen() -> None:
    clock = VirtualClock()
    seen: list[int] = []
    clock.at(1.0, lambda: seen.append(1)).cancel()
    assert clock.next_event() == float("inf")
    clock.sleep_until(2.0)
    assert seen == []


def test_a_virtual_clock_belongs_to_one_thread() -> None:
    clock = VirtualClock()
    clock.sleep_until(1.0)
    failures: list[Exception] = []

    def other() -> None:
        try:
            clock.sleep_until(2.0)
        except RuntimeError as error:
            failures.append(error)

    thread = threading.Thread(target=other)
    thread.start()
    thread.join()
    assert len(failures) == 1


def test_a_fast_real_clock_waits_for_its_own_time() -> None:
    clock = RealClock(speed=1000.0)
    start = clock.now()
    clock.sleep_until(start + 5.0)
    assert clock.now() >= start + 5.0


def test_a_real_clock_calls_at_a_time() -> None:
    clock = RealClock(speed=100.0)
    called = threading.Event()
    clock.at(clock.now() + 1.0, called.set)
    assert called.wait(10.0)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_a_real_clock_does_not_run_backwards(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        RealClock(speed)


@pytest.mark.parametrize("text", ["", "yesterday", "2026-13-01T00:00:00+00:00", "0001-01-01T00:00:00+14:00"])
def test_a_text_that_is_no_time_stays_as_it_is(text: str) -> None:
    assert local_stamp(text) == text


def test_a_time_of_this_zone_is_the_same_time() -> None:
    found = local_stamp("2026-01-31T14:05:00+03:00")
    assert datetime.fromisoformat(found.replace(" UTC", "")) == datetime.fromisoformat("2026-01-31T11:05:00+00:00")
