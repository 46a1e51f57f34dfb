"""A key that acts when it is held for some time, and not when it is tapped.

A hold is measured by the time stamps that the system gives the key's events: a window that stalls takes these late. Qt's mark
of auto-repeat is not asked: on X11 a key that repeats comes as release and press with one stamp, and Qt leaves the mark out
where it reads the release before the press has come.
"""

import enum
import math
from dataclasses import dataclass

from PySide6.QtCore import QCoreApplication, QEvent, QObject, Qt, QTimer, Signal, Slot
from PySide6.QtGui import QKeyEvent

from goniotwin.protocols.clock import Clock, RealClock

REPEAT_MS = 5
"""A press that follows a release within this time is auto-repeat, and no finger."""
LOOK_MS = 20
"""Time between two looks, and from a release to the end of the hold."""
LOOKS = 3
"""Looks before a key counts as held: between two of them comes what a stalled event loop has not taken yet, as the release."""
STAMPS = 1 << 32
"""Stamps start again after 2^32 ms on X11 and Windows: 50 days after the start of the system."""
PRESSES = frozenset({QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress})


@dataclass(frozen=True)
class Moment:
    """When an event happened and was taken: its stamp, ms since an arbitrary start (0: it has none), and the clock, ms."""

    stamp_ms: int
    clock_ms: float

    def since(self, earlier: "Moment") -> float:
        """The time since an earlier event, ms: by the stamps if both have one, else by the clock."""
        if self.stamp_ms and earlier.stamp_ms:
            return (self.stamp_ms - earlier.stamp_ms + STAMPS // 2) % STAMPS - STAMPS // 2
        return self.clock_ms - earlier.clock_ms


class Change(enum.Enum):
    """What an event or a look has shown: each once a hold."""

    BEGUN = enum.auto()
    HELD = enum.auto()
    """The key has been down for the time."""
    ENDED = enum.auto()
    """The key is up."""


class HeldKey:
    """The rule, without Qt: takes the presses and releases of a key, auto-repeat among them, and is looked at between them.

    A hold is from its first press to a release that no press follows within REPEAT_MS. An event may come several times, as it
    does that goes from a widget to its parents.
    """

    def __init__(self, hold_ms: float) -> None:
        self.hold_ms = hold_ms
        self._pressed: Moment | None = None
        self._released: Moment | None = None
        self._held = self._ended = False
        self._looks = 0

    def press(self, at: Moment) -> Change | None:
        """Take a press: the first of a hold, or auto-repeat."""
        if self._pressed is None or (self._released is not None and at.since(self._released) > REPEAT_MS):
            self._pressed, self._released = at, None
            self._held, self._ended, self._looks = False, False, 0
            return Change.BEGUN
        self._released, self._ended = None, False
        return self._judge(at.since(self._pressed))

    def release(self, at: Moment) -> Change | None:
        """Take a release: the end of a hold, or auto-repeat, as the next press shows."""
        if self._pressed is None or self._released is not None:
            return None
        self._released = at
        return self._judge(at.since(self._pressed))

    def forget(self) -> None:
        """End a hold without its release, which another program may get."""
        self._pressed = self._released = None

    def look(self, clock_ms: float) -> Change | None:
        """Look whether the key has been held by now, or is up."""
        if self._released is not None:
            if self._ended or clock_ms - self._released.clock_ms < LOOK_MS:
                return None
            self._ended = True
            return Change.ENDED
        if self._pressed is None:
            return None
        down_ms = clock_ms - self._pressed.clock_ms
        self._looks += down_ms >= self._first_look_ms
        return self._judge(down_ms) if self._looks >= LOOKS else None

    def next_look_ms(self, clock_ms: float) -> float | None:
        """The time to the next look, ms; None if there is nothing to look for."""
        if self._released is not None:
            return None if self._ended else self._released.clock_ms + LOOK_MS - clock_ms
        if self._pressed is None or self._held:
            return None
        return max(self._pressed.clock_ms + self._first_look_ms - clock_ms, LOOK_MS if self._looks else 0.0)

    @property
    def _first_look_ms(self) -> float:
        return self.hold_ms - (LOOKS - 1) * LOOK_MS

    def _judge(self, down_ms: float) -> Change | None:
        if self._held or down_ms < self.hold_ms:
            return None
        self._held = True
        return Change.HELD


class HeldKeyFilter(QObject):
    """Takes the events of a key from all windows of the program, before these; it keeps none from them."""

    begun = Signal()
    held = Signal()
    """The key has been down for the time, or its release shows that it was."""
    ended = Signal()

    def __init__(self, parent: QObject, key: Qt.Key, hold_ms: float, clock: Clock | None = None) -> None:
        super().__init__(parent)
        self.rule = HeldKey(hold_ms)
        self._key = key
        self._clock = clock or RealClock()
        self._timer = QTimer(self, singleShot=True, timerType=Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(self._look)
        application = QCoreApplication.instance()
        assert application is not None
        application.installEventFilter(self)

    @Slot()
    def forget(self) -> None:
        """End a hold that is not yet due."""
        self.rule.forget()
        self._timer.stop()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Take an event of the key; Qt calls it, for each event of the program."""
        del watched
        kind = event.type()
        if (kind in PRESSES or kind is QEvent.Type.KeyRelease) and isinstance(event, QKeyEvent) and event.key() == self._key:
            act = self.rule.release if kind is QEvent.Type.KeyRelease else self.rule.press
            self._follow(act(Moment(event.timestamp(), self._now_ms())))
        return False

    @Slot()
    def _look(self) -> None:
        self._follow(self.rule.look(self._now_ms()))

    def _follow(self, change: Change | None) -> None:
        wait = self.rule.next_look_ms(self._now_ms())
        if wait is None:
            self._timer.stop()
        else:
            self._timer.start(max(math.ceil(wait), 0))
        match change:
            case Change.BEGUN:
                self.begun.emit()
            case Change.HELD:
                self.held.emit()
            case Change.ENDED:
                self.ended.emit()

    def _now_ms(self) -> float:
        return 1000.0 * self._clock.now()
