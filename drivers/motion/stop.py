"""Stop of all axes on several wires at once: a wire whose controller does not respond delays the stop frames of no other.

Each controller carries out its stop in short steps, and `stop_all` interleaves them in one thread, because a virtual clock
belongs to one thread.
"""

from collections.abc import Callable, Generator, Mapping
from enum import IntEnum

from goniotwin.drivers.errors import DeviceError


class StopPhase(IntEnum):
    """Progress of a stop on one wire."""

    BLOCKING = 0
    """The next step may block for long (a port is opened again): the other wires go first."""
    SENDING = 1
    """Stop frames or their confirmations are outstanding; no step blocks for longer than 10 ms."""
    ATTEMPTED = 2
    """The first attempt is over. What was not confirmed is sent once more."""
    ENDED = 3


StopSteps = Generator[StopPhase, None, list[DeviceError]]
"""The steps of a stop: each yields its phase; the result is what was not confirmed. The first step sends a frame at once."""
StopWait = Generator[StopPhase, None, None]


class _Stop:
    """A stop in progress on the wire of one controller."""

    def __init__(self, controller: str, steps: StopSteps) -> None:
        self._controller = controller
        self._steps = steps
        self.phase = StopPhase.SENDING
        self.failures: list[DeviceError] = []

    def step(self) -> None:
        """Carry out the next step. Any exception of a driver is a failure of its own axes only."""
        try:
            self.phase = self._next_phase()
        except Exception as error:  # noqa: BLE001  (the other controllers must be stopped)
            self.phase = StopPhase.ENDED
            self._fail(error)

    def close(self) -> None:
        """Release its line."""
        try:
            self._steps.close()
        except Exception as error:  # noqa: BLE001  (the other lines must be released)
            self._fail(error)

    def _next_phase(self) -> StopPhase:
        try:
            return StopPhase(next(self._steps))
        except StopIteration as end:
            self.failures = list(end.value)
            return StopPhase.ENDED

    def _fail(self, error: Exception) -> None:
        self.failures = self.failures or [driver_failure(self._controller, error)]


def driver_failure(device: str, error: Exception) -> DeviceError:
    """The failure of a stop by any exception of a driver."""
    if isinstance(error, DeviceError):
        return error
    happened = f"{type(error).__name__}: {error}"
    return DeviceError(device, "stop", happened, "cut the motors' power if an axis still turns")


def request_stop(begin_stop: Callable[[], StopSteps]) -> StopSteps:
    """Request the stop of a controller. An exception of its driver is raised by the steps, so that the others are stopped."""
    try:
        return begin_stop()
    except Exception as error:  # noqa: BLE001  (the other controllers must be stopped)
        return _failing_steps(error)


def _failing_steps(error: Exception) -> StopSteps:
    yield StopPhase.SENDING
    raise error


def stop_all(stops: Mapping[str, StopSteps], then: Callable[[], None] = lambda: None) -> list[DeviceError]:
    """Carry out the stops of controllers, by their names, side by side; return what was not confirmed.

    One thread at a time: each stop holds its line until all have ended.
    `then` is called after the first attempt of all, before the second one.
    """
    running = [_Stop(name, steps) for name, steps in stops.items()]
    try:
        _advance(running, StopPhase.ATTEMPTED)
        then()
        _advance(running, StopPhase.ENDED)
    finally:
        for stop in running:
            stop.close()
    return [failure for stop in running for failure in stop.failures]


def _advance(stops: list[_Stop], phase: StopPhase) -> None:
    """Carry out steps in turn until all stops are in a phase; a step that may block waits until the others are there."""
    while behind := [stop for stop in stops if stop.phase < phase]:
        ready = [stop for stop in behind if stop.phase is not StopPhase.BLOCKING]
        for stop in ready or behind[:1]:
            stop.step()
