"""The simulation control port of a served virtual rig: one JSON object a line, over a channel; no wire of the instrument.

    {"do": "mount", "sample": "etalon"}         {"do": "lamp", "drift_per_hour": 0.1, "level": 0.9}
    {"do": "tilt", "deg": 0.05}                 {"do": "jam", "axis": "beta", "jammed": true}
    {"do": "state"}                             {"do": "faults", ...} and the plugs: see `mocks.faulty_wires`

Each gets `{"ok": true, ...}` or `{"ok": false, "error": "..."}`. Before the first one both sides prove the server's token: see
`protocols.channel`.
"""

import contextlib
import reprlib
from collections.abc import Callable
from typing import Any

from goniotwin.protocols.channel import Channel, ChannelServer, connect, new_token
from goniotwin.protocols.clock import Clock
from goniotwin.twin import VirtualRig

STEEPEST_TILT_DEG = 10.0


class OrderRefused(ValueError):
    """An order that cannot be carried out; the message has the reason."""


Order = dict[str, Any]
Action = Callable[[Order], dict[str, Any] | None]


class ControlPort:
    """Orders to a virtual rig apart from its wires; `others` are the orders about the served endpoints."""

    def __init__(self, rig: VirtualRig, others: dict[str, Action] | None = None) -> None:
        self._rig = rig
        self._clock: Clock = rig.clock
        self._own: dict[str, Action] = {
            "mount": self._mount,
            "lamp": self._lamp,
            "tilt": self._tilt,
            "jam": self._jam,
            "state": self._state,
        }
        self._actions = {**self._own, **(others or {})}

    def obey(self, order: Order) -> dict[str, Any]:
        """Carry out an order; return the answer, which contains any error."""
        try:
            what = order.get("do")
            if not isinstance(what, str) or what not in self._actions:
                raise OrderRefused(f'an order is {{"do": ...}} with one of: {", ".join(sorted(self._actions))}')
            # the other orders wait for threads that need the rig themselves
            with self._rig.lock if what in self._own else contextlib.nullcontext():
                return {"ok": True, **(self._actions[what](order) or {})}
        except OSError as error:
            return refusal(str(error))
        except (OrderRefused, KeyError) as error:
            return refusal(str(error.args[0] if error.args else error))

    def _mount(self, order: Order) -> None:
        if "sample" not in order:
            raise OrderRefused("sample is missing: give a name, or null to take it out")
        sample = order["sample"]
        if sample is not None and not isinstance(sample, str):
            raise OrderRefused("sample is a name, or null for none")
        self._rig.mount(sample)

    def _lamp(self, order: Order) -> None:
        drift = number(order, "drift_per_hour") if "drift_per_hour" in order else None
        level = number(order, "level") if "level" in order else None
        if level is not None and level < 0.0:
            raise OrderRefused(f"level is 0 or more, 1 for the nominal one, not {level:g}")
        self._rig.plant.set_lamp(self._clock.now(), drift_per_hour=drift, level=level)

    def _tilt(self, order: Order) -> None:
        deg = number(order, "deg")
        if abs(deg) > STEEPEST_TILT_DEG:
            raise OrderRefused(f"deg is from -{STEEPEST_TILT_DEG:g} to {STEEPEST_TILT_DEG:g}, not {deg:g}")
        self._rig.plant.tilt_sample(deg, self._clock.now())

    def _jam(self, order: Order) -> None:
        axis = order.get("axis")
        if not isinstance(axis, str) or axis not in self._rig.plant.shafts:
            raise OrderRefused(f"axis is one of: {', '.join(self._rig.plant.shafts)}")
        self._rig.plant.shafts[axis].jam(self._clock.now(), truth_value(order, "jammed", default=True))

    def _state(self, order: Order) -> dict[str, Any]:
        del order
        now = self._clock.now()
        plant = self._rig.plant
        return {
            "t_s": now,
            "angles_deg": {axis: plant.angle_deg(axis, now) for axis in plant.shafts},
            "wavelength_nm": plant.wavelength_nm.at(now),
            "shutter_open": plant.shutter_open.at(now),
            "sample": plant.sample.at(now),
        }


def number(order: Order, key: str) -> float:
    """Finite number of an order. Raises OrderRefused."""
    value = order.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1e9 < value < 1e9:
        raise OrderRefused(f"{key} is a number, not {reprlib.repr(value)}")
    return float(value)


def truth_value(order: Order, key: str, *, default: bool) -> bool:
    """True or false of an order. Raises OrderRefused."""
    value = order.get(key, default)
    if not isinstance(value, bool):
        raise OrderRefused(f"{key} is true or false, not {reprlib.repr(value)}")
    return value


def refusal(error: str) -> dict[str, Any]:
    """The answer to a refused order, with the reason."""
    return {"ok": False, "error": error}


class ControlServer(ChannelServer):
    """Server of the control port, with a token of its own."""

    def __init__(self, door: ControlPort, port: int = 0) -> None:
        def serve(channel: Channel) -> None:
            while (order := channel.receive()) is not None:
                channel.send(door.obey(order))

        super().__init__("control", new_token(), serve, port)


class ControlClient:
    """A client: the operator of a rig that another process serves."""

    def __init__(self, port: int, token: str, timeout_s: float = 10.0) -> None:
        """Connect. Raises OSError where nothing is served, or by a program that does not prove the token."""
        self._channel = connect(port, token, timeout_s)

    def do(self, what: str, **order: object) -> dict[str, Any]:
        """Carry out an order. Raises OrderRefused where it cannot be, OSError after the end of the server."""
        self._channel.send({"do": what, **order})
        answer = self._channel.receive()
        if answer is None:
            raise ConnectionResetError("the rig is not served any more")
        if not answer.pop("ok"):
            raise OrderRefused(answer["error"])
        return answer

    def mount(self, sample: str) -> None:
        """Mount a sample in the served rig."""
        self.do("mount", sample=sample)

    def close(self) -> None:
        """Close the connection."""
        self._channel.close()
