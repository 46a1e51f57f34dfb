"""A key that is held: by the stamps of its events, whatever Qt marks, and however late a stalled window takes them."""

from collections.abc import Sequence
from dataclasses import dataclass

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from PySide6.QtCore import QCoreApplication, QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from goniotwin.app.desktop.held_key import LOOK_MS, LOOKS, REPEAT_MS, STAMPS, Change, HeldKey, HeldKeyFilter, Moment
from goniotwin.app.desktop.run.panel import HOLD_MS
from goniotwin.protocols.clock import VirtualClock

ENDS_MS = 10_000.0
PRESS, RELEASE = True, False
Stall = tuple[float, float]
"""Begin and end, ms."""


@dataclass(frozen=True)
class Keyboard:
    """How a keyboard repeats a key that is down: as pairs of release and press (X11), as presses alone (Windows), or not."""

    delay_ms: int = 660
    period_ms: int = 40
    pairs: bool = True
    apart_ms: int = 0
    """From the release to the press of a pair, by their stamps."""

    def events(self, holds: Sequence[tuple[int, int]]) -> list[tuple[int, bool]]:
        """Time and kind of the events of fingers that are down from one time to another."""
        events = []
        for down, up in holds:
            events.append((down, PRESS))
            for at in range(down + self.delay_ms, up - self.apart_ms, self.period_ms):
                events += [(at, RELEASE), (at + self.apart_ms, PRESS)] if self.pairs else [(at, PRESS)]
            events.append((up, RELEASE))
        return events


X11 = Keyboard()


def stops_of(
    events: Sequence[tuple[int, bool]],
    stalls: Sequence[Stall] = (),
    *,
    first_stamp: int | None = 1,
    late_ms: float = 0.0,
    copies: int = 1,
) -> list[float]:
    """When a hold has stopped something, in a simulated event loop.

    It does nothing in a stall. After one it takes the time that is due first, and what has come meanwhile `late_ms` later.
    `first_stamp` is the stamp at the time 0; without it the events have none. Each event comes `copies` times.
    """
    taken_at, queue = 0.0, []
    for at, kind in events:
        taken_at = max(taken_at, next((end + late_ms for begin, end in stalls if begin <= at < end + late_ms), float(at)))
        stamp = 0 if first_stamp is None else (first_stamp + at) % STAMPS or 1
        queue += [(taken_at, stamp, kind)] * copies
    key, stops, now = HeldKey(HOLD_MS), [], 0.0
    while now < ENDS_MS:
        wait = key.next_look_ms(now)
        looks_at = ENDS_MS if wait is None else now + max(wait, 0.0)
        looks_at = next((end for begin, end in stalls if begin <= looks_at < end), looks_at)
        if queue and queue[0][0] < looks_at:
            now, stamp, kind = queue.pop(0)
            change = (key.press if kind is PRESS else key.release)(Moment(stamp, now))
        else:
            now = looks_at
            change = key.look(now)
        if change is Change.HELD:
            stops.append(now)
    assert queue == []
    return stops


keyboards = st.builds(
    Keyboard, st.integers(150, 900), st.integers(15, 100), pairs=st.booleans(), apart_ms=st.integers(0, REPEAT_MS)
)


@st.composite
def fingers(draw: st.DrawFn) -> list[tuple[int, int]]:
    """Times at which a key is down."""
    holds, at = [], 0
    for _ in range(draw(st.integers(1, 3))):
        at += draw(st.integers(REPEAT_MS + 1, 1000))
        holds.append((at, at := at + draw(st.integers(10, 2000))))
    return holds


@st.composite
def some_stalls(draw: st.DrawFn) -> list[Stall]:
    """Stalls that are far enough apart for the loop to take what has come meanwhile."""
    stalls, at = [], 0
    for _ in range(draw(st.integers(0, 3))):
        at += draw(st.integers(100, 1500))
        stalls.append((float(at), float(at := at + draw(st.integers(1, 1500)))))
    return stalls


@given(
    fingers(),
    keyboards,
    some_stalls(),
    st.integers(1, STAMPS - 1),
    st.floats(0.0, (LOOKS - 1) * LOOK_MS - 1.0),
    st.integers(1, 3),
)
@example([(100, 1200)], X11, [(50.0, 1550.0)], 1, 0.0, 1)  # a hold of 1.1 s in a stall
@example([(100, 200), (1300, 1400)], X11, [(50.0, 1550.0)], 1, 0.0, 1)  # two taps 1.2 s apart in one
@example([(100, 600)], X11, [(550.0, 2050.0)], 1, 39.0, 1)  # the release comes after two looks that found nothing
def test_each_hold_of_a_second_stops_once_and_no_shorter_one_does(
    holds: list[tuple[int, int]], keyboard: Keyboard, stalls: list[Stall], first_stamp: int, late_ms: float, copies: int
) -> None:
    wanted = [down for down, up in holds if up - down >= HOLD_MS]
    stops = stops_of(keyboard.events(holds), stalls, first_stamp=first_stamp, late_ms=late_ms, copies=copies)
    assert len(stops) == len(wanted)
    assert all(stop >= down + HOLD_MS for stop, down in zip(stops, wanted, strict=True))


@given(fingers(), keyboards, st.one_of(st.none(), st.integers(1, STAMPS - 1)))
def test_a_window_that_does_not_stall_stops_after_a_second(
    holds: list[tuple[int, int]], keyboard: Keyboard, first_stamp: int | None
) -> None:
    """Also without stamps, by the clock; between a release and a press of auto-repeat it waits for the press."""
    wanted = [float(down + HOLD_MS) for down, up in holds if up - down >= HOLD_MS]
    stops = stops_of(keyboard.events(holds), first_stamp=first_stamp)
    assert stops == pytest.approx(wanted, abs=LOOK_MS + REPEAT_MS)


@pytest.mark.parametrize(("until", "stopped"), [(1999, []), (2000, [2500.0]), (3200, [2500.0])])
def test_after_a_stall_the_release_stops_if_its_stamp_is_a_second_after_the_press(until: int, stopped: list[float]) -> None:
    """The press at 1 s and the release are taken at 2.5 s, from a keyboard that does not repeat."""
    slow = Keyboard(delay_ms=10_000)
    held = stops_of(slow.events([(1000, until)]), [(900.0, 2500.0)])
    assert held == ([] if not stopped else stopped if until < 2500 else [until])


def test_the_time_of_auto_repeat_is_five_milliseconds_by_the_stamps() -> None:
    for apart, stops in ((REPEAT_MS, 1), (REPEAT_MS + 1, 0)):
        assert len(stops_of([(0, PRESS), (600, RELEASE), (600 + apart, PRESS), (1100, RELEASE)])) == stops


def test_a_release_without_a_press_stops_nothing() -> None:
    """Long after a tap: the press went elsewhere."""
    assert stops_of([(0, PRESS), (100, RELEASE), (3000, RELEASE)]) == []


def test_a_hold_that_is_forgotten_stops_nothing_until_a_second_after_the_next_press() -> None:
    key = HeldKey(HOLD_MS)
    key.press(Moment(1, 0.0))
    key.forget()
    assert key.next_look_ms(999.0) is None
    assert key.release(Moment(1500, 1500.0)) is None
    assert key.press(Moment(1600, 1600.0)) is Change.BEGUN
    assert key.press(Moment(2600, 2600.0)) is Change.HELD


def test_the_end_of_a_hold_is_reported_once_and_not_between_release_and_press_of_auto_repeat() -> None:
    key = HeldKey(HOLD_MS)
    key.press(Moment(1, 0.0))
    key.release(Moment(500, 500.0))
    assert key.look(500.0 + LOOK_MS - 1) is None
    key.press(Moment(500, 510.0))
    assert key.look(500.0 + LOOK_MS) is None
    key.release(Moment(700, 700.0))
    assert [key.look(700.0 + LOOK_MS), key.look(800.0)] == [Change.ENDED, None]
    assert key.next_look_ms(800.0) is None


class Hands:
    """Sends key events with stamps to a widget, and counts what a filter reports."""

    def __init__(self, widget: QWidget) -> None:
        self.widget = widget
        self.clock = VirtualClock()
        self.stops = 0
        self._filter = HeldKeyFilter(widget, Qt.Key.Key_Escape, HOLD_MS, self.clock)
        self._filter.held.connect(self._count)

    def _count(self) -> None:
        self.stops += 1

    def send(self, kind: QEvent.Type, stamp_ms: int, key: Qt.Key = Qt.Key.Key_Escape, *, repeats: bool = False) -> None:
        event = QKeyEvent(kind, key, Qt.KeyboardModifier.NoModifier, "", repeats)
        event.setTimestamp(stamp_ms)
        QCoreApplication.sendEvent(self.widget, event)


@pytest.fixture
def hands(qtbot: QtBot) -> Hands:
    widget = QWidget()
    qtbot.addWidget(widget)
    return Hands(widget)


@pytest.mark.parametrize("marked", [True, False])
@pytest.mark.parametrize("press", [QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress])
def test_qt_events_of_the_key_are_taken_with_their_stamps_whatever_is_marked(
    hands: Hands, press: QEvent.Type, marked: bool
) -> None:
    """Where a shortcut has the key, only ShortcutOverride and the release come. The clock stands still: all come at once."""
    hands.send(press, 1000)
    for stamp in range(1660, 2000, 40):
        hands.send(QEvent.Type.KeyRelease, stamp, repeats=marked)
        hands.send(press, stamp, repeats=marked)
    assert hands.stops == 0
    hands.send(QEvent.Type.KeyRelease, 2000)
    assert hands.stops == 1


def test_another_key_is_none_of_its_concern(hands: Hands) -> None:
    hands.send(QEvent.Type.KeyPress, 1000, Qt.Key.Key_Return)
    hands.send(QEvent.Type.KeyRelease, 3000, Qt.Key.Key_Return)
    assert hands.stops == 0


def test_events_without_a_stamp_are_timed_by_the_clock(hands: Hands) -> None:
    for seconds, stops in ((0.9, 0), (1.0, 1)):
        hands.send(QEvent.Type.KeyPress, 0)
        hands.clock.sleep_until(hands.clock.now() + seconds)
        hands.send(QEvent.Type.KeyRelease, 0)
        assert hands.stops == stops
        hands.clock.sleep_until(hands.clock.now() + 1.0)


def test_a_key_that_stays_down_stops_by_the_timer(qtbot: QtBot) -> None:
    """With a hold of a hundredth of a second, and real time."""
    widget = QWidget()
    qtbot.addWidget(widget)
    held = HeldKeyFilter(widget, Qt.Key.Key_Escape, 10)
    with qtbot.waitSignal(held.held):
        qtbot.keyPress(widget, Qt.Key.Key_Escape)
    with qtbot.waitSignal(held.ended):
        qtbot.keyRelease(widget, Qt.Key.Key_Escape)
