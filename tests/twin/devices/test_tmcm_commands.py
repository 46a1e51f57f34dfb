"""The virtual motion modules' commands that move nothing: parameters, EEPROM, ports, addresses; and several on a bus."""

import pytest

from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame, ReplyStatus
from goniotwin.protocols.tmcl_parameters import USER_BANK, AxisParameter, GlobalParameter, SearchCommand
from goniotwin.twin.devices import TmclLine
from goniotwin.twin.plant import AxisController, Mechanics, Plant, TwinModel
from tests.twin.devices.tmcl_bench import PER_DEG, Bench


def test_settings_survive_a_reset_where_they_were_stored() -> None:
    bench = Bench()
    bench.set(AxisParameter.RUN_CURRENT, 77, 1.0)
    bench.set(AxisParameter.STANDBY_CURRENT, 7, 1.0)
    bench.ask(Command.STAP, AxisParameter.RUN_CURRENT)
    bench.ask(Command.SGP, 3, 33, bank=USER_BANK)
    bench.ask(Command.SGP, 4, 44, bank=USER_BANK)
    bench.ask(Command.STGP, 3, bank=USER_BANK)
    bench.line.reset(2.0)
    assert bench.get(AxisParameter.RUN_CURRENT, 3.0) == 77
    assert bench.get(AxisParameter.STANDBY_CURRENT, 3.0) == 8
    assert bench.get(AxisParameter.UNIT_MODE, 3.0) == 0
    assert bench.ask(Command.GGP, 3, bank=USER_BANK, t=3.0) == 33
    assert bench.ask(Command.GGP, 4, bank=USER_BANK, t=3.0) == 0
    bench.set(AxisParameter.RUN_CURRENT, 1, 4.0)
    bench.ask(Command.RSAP, AxisParameter.RUN_CURRENT, t=4.0)
    assert bench.get(AxisParameter.RUN_CURRENT, 4.0) == 77


def test_a_reset_in_the_middle_of_a_move_leaves_the_shaft_where_it_was_and_counts_from_0() -> None:
    bench = Bench()
    bench.go(51_200, 1.0)
    bench.line.reset(3.0)
    assert bench.angle(3.0) == bench.angle(100.0) == pytest.approx(15_000 / PER_DEG)
    assert bench.get(AxisParameter.ACTUAL_POSITION, 4.0) == bench.get(AxisParameter.TARGET_POSITION, 4.0) == 0
    assert bench.get(AxisParameter.ENCODER_POSITION, 4.0) == 0


def test_a_factory_reset_is_silent_for_five_seconds_and_forgets_all() -> None:
    bench = Bench()
    bench.set(AxisParameter.RUN_CURRENT, 77, 1.0)
    bench.ask(Command.STAP, AxisParameter.RUN_CURRENT)
    bench.go(1000, 1.0)
    bench.line.outbox.clear()
    assert bench.frames(CommandFrame(1, Command.FACTORY_RESET, 0, 0, 1234), 20.0) == []
    assert bench.frames(CommandFrame(1, Command.GAP, 1, 4), 24.9) == []
    assert bench.get(AxisParameter.RUN_CURRENT, 25.1) == 128
    assert bench.get(AxisParameter.ACTUAL_POSITION, 25.1) == 0
    assert bench.refused(Command.FACTORY_RESET, 0, 1233, t=26.0, bank=0) == ReplyStatus.INVALID_VALUE


def test_a_locked_eeprom_reports_its_status() -> None:
    bench = Bench()
    bench.ask(Command.SGP, GlobalParameter.EEPROM_LOCK, 1234, bank=0)
    assert bench.refused(Command.STAP, AxisParameter.RUN_CURRENT) == ReplyStatus.EEPROM_LOCKED
    assert bench.refused(Command.STGP, 3, bank=USER_BANK) == ReplyStatus.EEPROM_LOCKED
    bench.ask(Command.SGP, GlobalParameter.EEPROM_LOCK, 4321, bank=0)
    bench.ask(Command.STAP, AxisParameter.RUN_CURRENT)


def test_ports() -> None:
    bench = Bench()
    assert bench.ask(Command.GIO, 8, bank=1) == 240  # 24 V in 0.1 V
    assert bench.ask(Command.GIO, 9, bank=1) == 30
    assert bench.ask(Command.SIO, 2, 1, bank=2) == 1
    assert (bench.ask(Command.GIO, 2, bank=2), bench.ask(Command.GIO, 3, bank=2)) == (1, 0)
    assert bench.refused(Command.SIO, 99, 1, bank=2) == ReplyStatus.WRONG_TYPE
    assert bench.refused(Command.GIO, 0, bank=7) == ReplyStatus.INVALID_VALUE


def test_the_stand_alone_program_has_a_status() -> None:
    bench = Bench()
    for command, status in ((129, 1), (128, 0), (131, 3)):
        bench.ask(command, 0, bank=0)
        assert bench.ask(Command.APPLICATION_STATUS, 0, bank=0) == status
        assert bench.ask(Command.GGP, GlobalParameter.APPLICATION_STATUS, bank=0) == status


def test_the_tick_timer_runs_and_random_numbers_differ() -> None:
    bench = Bench()
    bench.ask(Command.SGP, GlobalParameter.TICK_TIMER, 100, t=10.0, bank=0)
    assert bench.ask(Command.GGP, GlobalParameter.TICK_TIMER, t=10.5, bank=0) == 600
    assert len({bench.ask(Command.GGP, GlobalParameter.RANDOM_NUMBER, t=11.0 + k, bank=0) for k in range(10)}) == 10


def test_old_firmware_has_no_get_info() -> None:
    assert Bench().refused(Command.GET_INFO, 0) == ReplyStatus.NOT_AVAILABLE


def test_coordinates() -> None:
    bench = Bench()
    assert bench.ask(Command.SCO, 3, 12_345) == 12_345
    assert bench.ask(Command.MVP, 2, 3) == 12_345
    assert bench.ask(Command.CCO, 4, t=100.0) == bench.ask(Command.GCO, 4, t=100.0) == 12_345
    assert bench.refused(Command.MVP, 2, 21, t=101.0) == ReplyStatus.INVALID_VALUE


def test_a_suppressed_or_a_late_reply() -> None:
    bench = Bench()
    bench.ask(Command.SGP, GlobalParameter.TELEGRAM_PAUSE, 20, bank=0)
    bench.line.receive(CommandFrame(1, Command.GAP, 1, 4).encode(), 2.0)
    assert bench.line.outbox.popleft()[0] == pytest.approx(2.0 + 0.020 + 3.0e-4)
    assert bench.frames(CommandFrame(1, Command.SGP, GlobalParameter.SUPPRESS_REPLY, 0, 1), 3.0) == []
    assert bench.frames(CommandFrame(1, Command.GAP, 1, 4), 4.0) == []


def test_the_hosts_address_is_a_setting() -> None:
    bench = Bench()
    bench.ask(Command.SGP, GlobalParameter.HOST_ADDRESS, 9, bank=0)
    assert bench.reply(CommandFrame(1, Command.GAP, 1, 4), 2.0).host == 9


@pytest.mark.parametrize(
    ("command", "kind", "value", "status"),
    [
        (Command.SAP, AxisParameter.ACTUAL_VELOCITY, 1, ReplyStatus.WRONG_TYPE),
        (Command.SAP, AxisParameter.REFERENCE_SEARCH_MODE, 9, ReplyStatus.INVALID_VALUE),
        (Command.SAP, AxisParameter.MAX_VELOCITY, 8_000_000, ReplyStatus.INVALID_VALUE),
        (Command.GAP, 153, 0, ReplyStatus.WRONG_TYPE),  # the TMC429's divisors are not there
        (Command.STAP, AxisParameter.ACTUAL_POSITION, 0, ReplyStatus.WRONG_TYPE),
        (Command.RFS, 3, 0, ReplyStatus.WRONG_TYPE),
        (Command.REQUEST_TARGET_REACHED, 0, 64, ReplyStatus.INVALID_VALUE),
        (Command.SGP, GlobalParameter.HEARTBEAT, -1, ReplyStatus.INVALID_VALUE),
        (99, 0, 0, ReplyStatus.INVALID_COMMAND),
    ],
)
def test_refusals(command: int, kind: int, value: int, status: ReplyStatus) -> None:
    bank = 0 if command == Command.SGP else None
    assert Bench().refused(command, kind, value, bank=bank) == status


def bus(wire: str = "rs485") -> TmclLine:
    axes = {name: Mechanics(0, 36.0, module=address) for name, address in (("gamma", 1), ("sigma", 2), ("beta", 7))}
    controller = AxisController(kind="tmcm-1240", wire=wire, baudrate=9600)  # type: ignore[arg-type]
    return TmclLine(Plant(TwinModel(1, axes, {}, controller=controller, noise=False)))


def exchange(line: TmclLine, request: CommandFrame, t: float) -> list[bytes]:
    line.receive(request.encode(), t)
    found = [data for _, data in line.outbox]
    line.outbox.clear()
    return found


def test_modules_on_a_bus_answer_to_their_own_addresses() -> None:
    line = bus()
    (answer,) = exchange(line, CommandFrame(2, Command.FIRMWARE_VERSION, 1, 0), 1.0)
    assert ReplyFrame.decode(answer) == ReplyFrame(2, 2, ReplyStatus.OK, Command.FIRMWARE_VERSION, 1240 << 16 | 1 << 8 | 45)
    assert exchange(line, CommandFrame(2, Command.FIRMWARE_VERSION, 0, 0), 1.5) == [b"\x021240V145"]
    assert exchange(line, CommandFrame(3, Command.FIRMWARE_VERSION, 1, 0), 2.0) == []
    (answer,) = exchange(line, CommandFrame(7, Command.GAP, 1, 1), 3.0)
    assert ReplyFrame.decode(answer).status == ReplyStatus.INVALID_VALUE  # it has one motor


@pytest.mark.parametrize("frame", ["00 88 01 00 00 00 00 00 89", "03 88 01 00 00 00 00 00 8C", "00 88 01 00 00 00 00 00 00"])
def test_on_rs485_another_address_is_silent_and_over_usb_any_is_answered(frame: str) -> None:
    """The maker's own firmware compares the address of RS485 before the checksum and ignores that of USB.

    Trinamic, "stepRocker Mini-TMCL", `ProcessCommand` in Commands.c.
    """
    line = bus()
    line.receive(bytes.fromhex(frame), 1.0)
    assert not line.outbox
    usb = Bench().line
    usb.receive(bytes.fromhex(frame), 1.0)
    assert [data[:2] for _, data in usb.outbox] == [b"\x02\x01"]


def test_answers_of_modules_with_the_same_address_collide() -> None:
    line = bus()
    exchange(line, CommandFrame(7, Command.SGP, GlobalParameter.HOST_ADDRESS, 0, 4), 1.0)
    exchange(line, CommandFrame(7, Command.SGP, GlobalParameter.ADDRESS, 0, 2), 1.5)
    (answer,) = exchange(line, CommandFrame(2, Command.FIRMWARE_VERSION, 1, 0), 2.0)
    assert answer[0] == 2 & 4  # the host's addresses of both at once


def test_a_module_on_a_bus_can_be_given_another_address() -> None:
    line = bus()
    exchange(line, CommandFrame(2, Command.SGP, GlobalParameter.ADDRESS, 0, 5), 1.0)
    assert exchange(line, CommandFrame(2, Command.GAP, 1, 0), 2.0) == []
    assert len(exchange(line, CommandFrame(5, Command.GAP, 1, 0), 3.0)) == 1


def test_a_wire_with_an_unknown_motor_is_refused() -> None:
    with pytest.raises(ValueError, match="motor 4 of module 1"):
        Bench(AxisController(kind="tmcm-1240"))


def test_a_1240_has_a_search_too() -> None:
    bench = Bench(AxisController(kind="tmcm-1240", wire="rs485"), motor=0, module=3, home_deg=1.0)
    bench.set(AxisParameter.REFERENCE_SEARCH_MODE, 7, 0.0)
    bench.search(SearchCommand.START, 1.0)
    assert bench.search(SearchCommand.STATUS, 1000.0) == 0
    assert bench.angle(1000.0) == pytest.approx(1.0, abs=2.0 / PER_DEG)


def test_the_standby_current_comes_after_the_power_down_delay() -> None:
    bench = Bench()
    bench.set(AxisParameter.RUN_CURRENT, 200, 0.0)
    bench.set(AxisParameter.STANDBY_CURRENT, 20, 0.0)
    bench.set(AxisParameter.POWER_DOWN_DELAY, 100, 0.0)
    bench.go(20_000, 1.0)  # three seconds
    motor = bench.line.modules[1].motors[4]
    assert [motor.current(t) for t in (2.0, 4.5, 5.1)] == [200, 200, 20]
