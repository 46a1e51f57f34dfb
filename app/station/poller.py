"""The poller of an open rig: its positions, live readings, lamp and last answers, as reported while no run has the devices."""

from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial

from goniotwin.app.campaign.running.events import Positions
from goniotwin.app.campaign.running.stop import Stopped
from goniotwin.app.rig import AXES
from goniotwin.app.station.bench import Bench, PendingReading
from goniotwin.app.station.board import Board, Publish
from goniotwin.app.station.contacts import Contacts
from goniotwin.app.station.messages import BenchReading, LampRead, ReferencesChanged
from goniotwin.drivers import Axis, DeviceError
from goniotwin.drivers.errors import Unreferenced
from goniotwin.drivers.motion import MotionController
from goniotwin.protocols.clock import Clock, calendar_stamp

POLL_S = 0.2
"""Real time between two readings of the axis positions at rest."""
ENCODERS_S = 1.0
"""Real time between two comparisons of counters and encoders of axes at rest."""
LAMP_S = 1.0
"""Shortest real time between two reports of the monitor's current."""
DARK_TIMES = 3.0
"""The monitor shows light by more than so many times its current with the shutter closed."""
LIVE_POLL_S = 0.02
"""The same between two polls of live readings."""
LIVE_S = 0.1
"""Shortest real time between two live readings."""


class Poller:
    """Polls the devices of a bench, and publishes what they answer. In the engine's thread. `wall` is real time.

    It lives from the opening of a rig to its end, with the rig's `bench` and `contacts`.
    """

    def __init__(self, bench: Bench, board: Board, publish: Publish, wall: Clock) -> None:
        self.bench = bench
        self.contacts = Contacts(bench.opened.rig, board, wall)
        self._rig = bench.opened.rig
        self._board = board
        self._publish = publish
        self._wall = wall
        self._live: PendingReading | None = None
        self._live_due = 0.0
        self._settled = False
        self._monitor_dark_a = 0.0
        self._resting: dict[str, tuple[float, float]] = {}
        """Of axes: the counter, and the rig's time since which it is so."""
        self._encoders: dict[str, float | None] = {}
        self._due: defaultdict[str, float] = defaultdict(float)

    @property
    def interval_s(self) -> float:
        """Real time until something may be due again."""
        return LIVE_POLL_S if self._live is not None else POLL_S

    def poll(self, connect_lost: Callable[[], None]) -> None:
        """Poll what is due; `connect_lost` is the last of it."""
        now = self._wall.now()
        for name, every_s, action in (
            ("positions", POLL_S, self.poll_axes),
            ("live", LIVE_POLL_S, self._poll_live),
            ("ask", POLL_S, self._ask_devices),
            ("answered", POLL_S, self.contacts.report_answers_now_and_then),
            ("connect", POLL_S, connect_lost),
        ):
            if now >= self._due[name]:
                self._due[name] = now + every_s
                try:
                    action()
                except DeviceError as error:
                    self.contacts.note_fault(error)

    # ---- the axes ----

    def report_references(self) -> None:
        """Report which axes are unreferenced, if that has changed. Nothing is asked of them."""
        now = self._board.snapshot
        unreferenced = {name: axis.unreferenced_reason for name, axis in self._rig.axes.items() if axis.unreferenced_reason}
        if now.rig is not None and unreferenced != now.unreferenced:
            self._publish(ReferencesChanged(unreferenced))

    def poll_axes(self) -> None:
        """Report the positions of the axes whose controllers respond, and their encoders where they are at rest."""
        if self._board.snapshot.rig is None:
            return
        self.report_references()
        compares = self._wall.now() >= self._due["encoders"] and not self._board.snapshot.activity
        if compares:
            self._due["encoders"] = self._wall.now() + ENCODERS_S
        degrees: dict[str, float] = {}

        def read(axes: Mapping[str, Axis]) -> None:
            for name, axis in axes.items():
                degrees[name] = self._read_axis(axis, compares=compares)

        for controller in self._rig.controllers:
            self.contacts.ask(controller.name, partial(read, controller.axes))
        if degrees:
            encoders = {name: angle for name, angle in self._encoders.items() if name in degrees}
            self._publish(Positions({name: degrees[name] for name in AXES if name in degrees}, encoders))
            self.report_references()

    def _read_axis(self, axis: Axis, *, compares: bool) -> float:
        """Read the counter of an axis, and, if `compares` and it is at rest, its encoder. Raises DeviceError.

        An encoder that contradicts makes the axis unreferenced, as it does after a row.
        """
        counter, now = axis.position_deg(), self._rig.clock.now()
        before, since = self._resting.get(axis.name, (counter, now))
        if counter != before:
            since = now
            self._encoders.pop(axis.name, None)
        self._resting[axis.name] = counter, since
        if compares and axis.settings.encoder and now - since > axis.settings.settling_s:
            try:
                counter, encoder = axis.read_back()
            except Unreferenced:
                encoder = axis.encoder_deg()
            self._encoders[axis.name] = encoder
        return counter

    # ---- the light ----

    def set_live(self, on: bool) -> None:
        """Begin or end live readings; none begin after a stop of the bench."""
        self.bench.set_live(on and not self.bench.request.requested)
        self._due["live"] = 0.0

    def end_live(self) -> None:
        """End live readings: a run needs the photodiodes."""
        self.bench.set_live(False)
        self._live = None

    def _poll_live(self) -> None:
        bench = self.bench
        if not bench.settings.live or self._board.snapshot.activity:
            self._live, self._settled = None, False
            return
        now = self._wall.now()
        try:
            if self._live is None:
                self._live_due = now + LIVE_S
                self._live = bench.start_live(settled=self._settled)
            while self._live.due <= self._rig.clock.now() and self._wall.now() < now + LIVE_POLL_S:
                if self._live.poll():
                    reading, self._live, self._settled = self._live.result, None, True
                    self._due["live"] = self._live_due
                    self.report_reading(reading, shutter_open=bench.settings.shutter_open)
                    return
        except (DeviceError, Stopped) as error:
            self._live = None
            bench.set_live(False)
            self._publish(bench.settings)
            if isinstance(error, DeviceError):
                raise

    def report_reading(self, reading: BenchReading, *, shutter_open: bool | None) -> None:
        """Report a reading of photodiodes and monitor."""
        self.contacts.note_answers("photodiodes", "monitor")
        self._publish(reading)
        self.note_lamp(reading.monitor_a, shutter_open=shutter_open)

    def note_lamp(self, current_a: float | None, *, shutter_open: bool | None) -> None:
        """Report the monitor's current where the shutter is open; remember it where it is closed."""
        if current_a is None:
            return
        if shutter_open is False:
            self._monitor_dark_a = abs(current_a)
        elif shutter_open and self._wall.now() >= self._due["lamp"]:
            self._due["lamp"] = self._wall.now() + LAMP_S
            light = current_a > DARK_TIMES * self._monitor_dark_a
            self._publish(LampRead(current_a, light, calendar_stamp()))

    # ---- the answers of the devices ----

    def _ask_devices(self) -> None:
        """Ask devices that nothing uses, so that it is known when they last answered."""
        if self._board.snapshot.activity or self._board.snapshot.rig is None:
            return
        reads = () if self.bench.settings.live else (self._rig.photodiodes, self._rig.monitor)
        for device in (self._rig.monochromator, *reads):
            self.contacts.ask_now_and_then(device.name, device.check)

    def ask_devices_of_run(self) -> None:
        """Ask the devices whether they respond. What one has lost is the run's to restore, so nothing is restored here."""
        for controller in self._rig.controllers:
            self.contacts.ask(controller.name, partial(_read_positions, controller), recovered=True)
        light, photodiodes, monitor = self._rig.monochromator, self._rig.photodiodes, self._rig.monitor
        for name, question in ((light.name, light.ask), (photodiodes.name, photodiodes.check), (monitor.name, monitor.ask)):
            self.contacts.ask_now_and_then(name, question, recovered=True)
        self.contacts.report_answers_now_and_then()

    def report_place(self, axis: str) -> None:
        """Report counter and encoder of an axis at rest that the run asks about, as far as it responds."""
        asked = self._rig.axes[axis]
        try:
            counter, encoder = asked.position_deg(), asked.encoder_deg()
        except DeviceError as error:
            self.contacts.note_fault(error, recovered=True)
            return
        self.contacts.note_answers(self.bench.opened.rig.controller(axis).name)
        self.contacts.report_answers_now_and_then()
        others = {name: angle for name, angle in self._board.snapshot.encoders.items() if name != axis}
        self._publish(Positions({axis: counter}, {**others, axis: encoder} if asked.settings.encoder else others))
        self.report_references()


def _read_positions(controller: MotionController) -> None:
    for axis in controller.axes.values():
        axis.position_deg()
