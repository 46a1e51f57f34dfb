"""A plant with motion modules and nothing else, asked by frames at given times."""

from dataclasses import replace

from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame, ReplyStatus
from goniotwin.protocols.tmcl_parameters import AxisParameter, GlobalParameter, SearchCommand
from goniotwin.twin.devices import TmclLine
from goniotwin.twin.plant import AxisController, Mechanics, Plant, TwinModel

MOTOR = 4
GEAR = 36.0  # 10 deg of the axis are a turn of the motor: 51200 microsteps
PER_DEG = 5120


class Bench:
    """One axis, `sigma`, at motor 4 of a TMCM-6214, with 10000 pps, 10000 pps/s and units of pps."""

    def __init__(self, controller: AxisController | None = None, **mechanics: object) -> None:
        sigma = replace(Mechanics(motor=MOTOR, gear=GEAR), **mechanics)  # type: ignore[arg-type]
        self.plant = Plant(TwinModel(1, {"sigma": sigma}, {}, controller=controller or AxisController(), noise=False))
        self.line = TmclLine(self.plant)
        self.shaft = self.plant.shafts["sigma"]
        self.module = sigma.module
        self.motor = sigma.motor
        self.set(AxisParameter.UNIT_MODE, 1, t=0.0)
        for parameter in (AxisParameter.MAX_VELOCITY, AxisParameter.MAX_ACCELERATION, AxisParameter.MAX_DECELERATION):
            self.set(parameter, 10_000, t=0.0)

    def frames(self, request: CommandFrame, t: float) -> list[bytes]:
        """What comes back, without its times."""
        self.line.receive(request.encode(), t)
        found = [data for ready, data in self.line.outbox if ready <= t + 1.0]
        self.line.outbox.clear()
        return found

    def reply(self, request: CommandFrame, t: float) -> ReplyFrame:
        """The one answer."""
        (frame,) = self.frames(request, t)
        return ReplyFrame.decode(frame)

    def ask(self, command: int, kind: int, value: int = 0, t: float = 1.0, bank: int | None = None) -> int:
        """The value of an answer that is OK."""
        reply = self.reply(CommandFrame(self.module, command, kind, self.motor if bank is None else bank, value), t)
        assert reply.status == ReplyStatus.OK, reply
        return reply.value

    def refused(self, command: int, kind: int, value: int = 0, t: float = 1.0, bank: int | None = None) -> int:
        """The status of one that is not."""
        return self.reply(CommandFrame(self.module, command, kind, self.motor if bank is None else bank, value), t).status

    def get(self, parameter: int, t: float) -> int:
        """GAP."""
        return self.ask(Command.GAP, parameter, t=t)

    def set(self, parameter: int, value: int, t: float) -> int:
        """SAP."""
        return self.ask(Command.SAP, parameter, value, t)

    def go(self, target: int, t: float) -> int:
        """MVP ABS."""
        return self.ask(Command.MVP, 0, target, t)

    def search(self, kind: SearchCommand, t: float) -> int:
        """RFS."""
        return self.ask(Command.RFS, kind, t=t)

    def heartbeat(self, ms: int, t: float) -> int:
        """SGP 68."""
        return self.ask(Command.SGP, GlobalParameter.HEARTBEAT, ms, t, bank=0)

    def angle(self, t: float) -> float:
        """Of the axis, deg."""
        return self.shaft.angle_deg(t)
