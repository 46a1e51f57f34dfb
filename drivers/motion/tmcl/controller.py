"""A line of TMCL modules as the motion controller of its axes."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Le

from goniotwin.drivers.device import PortOpener
from goniotwin.drivers.errors import DeviceError
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.drivers.motion.stop import StopSteps
from goniotwin.drivers.motion.tmcl.axis import TmclAxis
from goniotwin.drivers.motion.tmcl.module import HEARTBEAT_S, LONGEST_HEARTBEAT_S, TmclModule
from goniotwin.drivers.motion.tmcl.rules import CANARY
from goniotwin.drivers.tap import Tap, no_tap
from goniotwin.keys import Count
from goniotwin.protocols.clock import Clock

SHORTEST_REPLY_TIMEOUT_S, LONGEST_REPLY_TIMEOUT_S = 0.02, 1.0
"""An exchange at 9600 Bd takes 20 ms. The engine may be blocked for 1 s: see `module`."""


@dataclass(frozen=True, kw_only=True)
class TmclSettings:
    """A serial line of Trinamic modules.

    `baudrate`: speed of the line. `heartbeat_s`: silence of the line after which the modules stop their motors; 0 is off.
    `reply_timeout_s`: longest wait for a reply. By default it is 0.06 s, at a network port 0.25 s, and below 57,600 Bd 0.5 s. A
    stop does not wait for it.
    """

    baudrate: Count = 115200
    heartbeat_s: Annotated[float, Ge(0.0), Le(LONGEST_HEARTBEAT_S)] = HEARTBEAT_S
    reply_timeout_s: Annotated[float, Ge(SHORTEST_REPLY_TIMEOUT_S), Le(LONGEST_REPLY_TIMEOUT_S)] | None = None


class TmclController:
    """The axes of one line, by their settings, and the modules that they name."""

    def __init__(
        self,
        name: str,
        open_port: PortOpener,
        clock: Clock,
        settings: TmclSettings,
        axes: Mapping[str, AxisSettings],
        tap: Tap = no_tap,
        session: int = CANARY,
        found: FoundSettings | None = None,
        speed: float = 1.0,
    ) -> None:
        """`session` is the canary: a number, not 0, that no other program has. `speed` is that of `TmclModule`."""
        self.name = name
        addresses = [axis.module for axis in axes.values()]
        self.module = TmclModule(
            open_port,
            clock,
            settings.baudrate,
            tap,
            addresses,
            settings.heartbeat_s,
            name,
            session,
            found,
            settings.reply_timeout_s,
            speed,
        )
        self.axes = {axis: TmclAxis(axis, self.module, table, clock) for axis, table in axes.items()}

    @property
    def parts(self) -> tuple[str, ...]:
        """The axes."""
        return tuple(self.axes)

    @property
    def model(self) -> str:
        """The model of the first module, once it has been identified."""
        return self.module.model

    @property
    def stop_count(self) -> int:
        """Number of stop requests so far."""
        return self.module.stop_count

    def identify(self) -> str:
        """Open the port and identify the modules. Nothing is written, nothing moves. Raises DeviceError."""
        identity = f"TMCM-{self.module.identify()}"
        self.module.found.take_up(identity)
        self._restore()
        return identity

    def connect(self) -> str:
        """Open the port, identify the modules, write the settings; an axis whose module has reset becomes unreferenced.

        Returns the identity. Nothing moves. Raises DeviceError.
        """
        number = self.module.connect()
        with self.module.patiently():
            for axis in self.axes.values():
                axis.connect()
        return f"TMCM-{number}"

    def reconnect(self) -> None:
        """Connect again after a fault. Raises DeviceError."""
        self.connect()

    def close(self) -> None:
        """Restore the settings that were found, unless a motor turns, and close the port. Nothing moves."""
        with contextlib.suppress(DeviceError):
            self._restore()
        self.module.close()

    def _restore(self) -> None:
        self.module.restore([(axis.settings.module, axis.settings.motor) for axis in self.axes.values()])

    def begin_stop(self) -> StopSteps:
        """Request a stop of all axes; return its steps. Thread-safe."""
        return self.module.begin_stop([each for axis in self.axes.values() for each in axis.stop_requests()])

    def set_heartbeat(self, seconds: float) -> None:
        """Set the heartbeat for the next connection."""
        self.module.heartbeat_s = min(seconds, LONGEST_HEARTBEAT_S)
