"""The serial line of one or several motion modules: bytes into frames, the frames to the modules, their answers back."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from goniotwin.protocols.tmcl import FRAME_BYTES, split
from goniotwin.twin.devices.tmcm6214 import MotionModule, UnsolicitedReply
from goniotwin.twin.plant import AxisController, Mechanics, ModuleKind

if TYPE_CHECKING:
    from goniotwin.twin.plant import Plant

IDLE_GAP_S = 0.05


class TmclLine:
    """One TMCM-6214, or several TMCM-1240 on an RS485 bus, by the controller and its axes' `module`.

    Without `controller` it is the plant's own, with the axes that no further device has.

    Over USB a module answers whatever address it is called by; on RS485 it is silent where another's is called. Replies of
    modules that were given the same address collide.

    `idle_gap_s` is the pause after which a frame that has been begun is forgotten; on an endpoint, whose bytes come when
    the system brings them, it has to be as much longer as the clock is faster.
    """

    def __init__(self, plant: "Plant", controller: AxisController | None = None, axes: tuple[str, ...] | None = None) -> None:
        controller = plant.model.controller if controller is None else controller
        axes = plant.model.controller_axes if axes is None else axes
        self.baudrate = controller.baudrate
        self.idle_gap_s = IDLE_GAP_S
        self.outbox: deque[tuple[float, bytes]] = deque()
        self._latency_s = controller.latency_s
        self._rest = b""
        self._last_byte = -math.inf
        mechanics = {axis: plant.model.axes[axis] for axis in axes}
        addresses = sorted({each.module for each in mechanics.values()}) or [1]
        self.modules = {
            address: MotionModule(plant, controller, motors(mechanics, address), address, self._post, self._withdraw)
            for address in addresses
        }

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`; a frame begun before a pause is forgotten."""
        if t - self._last_byte > self.idle_gap_s:
            self._rest = b""
        self._last_byte = t
        frames, self._rest = split(self._rest + data)
        for frame in frames:
            answers = [(pause, answer) for module in self.modules.values() for pause, answer in module.answer(frame, t)]
            if len(answers) == 1:
                self._post(t + self._latency_s + answers[0][0], answers[0][1])
            elif answers:  # they speak at the same time, and a line that one pulls down is down
                self._post(t + self._latency_s, _at_once([answer for _, answer in answers]))

    def reset(self, t: float) -> None:
        """All modules lose their power for a moment: what EEPROM does not keep is forgotten, counters are 0."""
        self._rest = b""
        self.outbox.clear()
        for module in self.modules.values():
            module.reset(t)

    def _post(self, t: float, data: bytes) -> None:
        """Queue an answer after earlier answers and before those that are due later."""
        later: list[tuple[float, bytes]] = []
        while self.outbox and isinstance(self.outbox[-1][1], UnsolicitedReply) and self.outbox[-1][0] > t:
            later.append(self.outbox.pop())
        self.outbox.append((t, data))
        self.outbox.extend(reversed(later))

    def _withdraw(self, data: bytes) -> None:
        """Remove an answer that is not sent yet."""
        left = [each for each in self.outbox if each[1] is not data]
        self.outbox.clear()
        self.outbox.extend(left)


@dataclass(frozen=True, kw_only=True)
class FurtherTmclLine(AxisController):
    """A further line of TMCL modules, for some of the axes.

    `axes`: names of the axes that it turns.
    """

    kind: ModuleKind = field()  # without the default of the line that every rig has
    axes: tuple[str, ...]

    def build(self, plant: "Plant") -> TmclLine:
        """The line on a plant."""
        return TmclLine(plant, self, self.axes)


def motors(axes: Mapping[str, Mechanics], address: int) -> dict[int, str]:
    """The axes of the module with an address, by the number of their motor."""
    return {mechanics.motor: name for name, mechanics in axes.items() if mechanics.module == address}


def _at_once(answers: list[bytes]) -> bytes:
    mixed = bytes((0xFF,)) * FRAME_BYTES
    for answer in answers:
        mixed = bytes(a & b for a, b in zip(mixed, answer, strict=True))
    return mixed
