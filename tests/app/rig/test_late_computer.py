"""A computer that is late: how long the axes of a rig may be without a request, and a reply late, by the rig file."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, open_rig, parse_rig, read_rig
from goniotwin.app.rig.served_file import served_rig
from goniotwin.drivers import TmclController, wait
from goniotwin.mocks.served import ServedRig
from goniotwin.protocols.clock import RealClock, VirtualClock
from goniotwin.protocols.tmcl import Command, CommandFrame
from goniotwin.protocols.tmcl_parameters import GlobalParameter
from tests.conftest import Writer

HEARTBEAT = CommandFrame(1, Command.GGP, GlobalParameter.HEARTBEAT, 0)
REAL = [
    ('port = "twin://virtual/mono"', 'port = "COM97"'),
    ('usb = "twin://virtual/monitor"', 'usb = "1313:8078"'),
    *((f'"twin://virtual/adc-{k}"', f'"127.0.0.1:{1500 + k}"') for k in range(5)),
]
pytestmark = pytest.mark.xdist_group("ports of one rig")  # its lock is for one test at a time
NETWORK = "socket://127.0.0.1:4001"
SLOW, KEY = "baudrate = 9600", "reply_timeout_s = 0.1"
Served = Callable[[float], OpenRig]


@pytest.fixture
def served(write_rig: Writer, tmp_path: Path) -> Iterator[Served]:
    """Function that serves a virtual rig at a speed; the drivers of the rig file that is written for it, connected."""
    ends: list[Callable[[], object]] = []

    def serve(speed: float) -> OpenRig:
        description = read_rig(write_rig())
        model = description.model()
        assert model is not None
        server = ServedRig(model, speed, tmp_path / f"ptys-{speed:g}", control=False)
        ends.append(server.stop)
        server.start()
        file = parse_rig(served_rig(description, server.endpoints, speed), tmp_path, "served.toml")
        opened = open_rig(file, RealClock(speed))
        ends.append(opened.close)
        opened.connect()
        return opened

    yield serve
    for end in reversed(ends):
        end()


def controller(opened: OpenRig) -> TmclController:
    """The controller of the axes."""
    (found,) = opened.rig.controllers
    assert isinstance(found, TmclController)
    return found


@pytest.mark.endpoint
@pytest.mark.parametrize(("speed", "written_s"), [(1.0, 2.0), (10.0, 20.0), (60.0, 65.0)])
def test_the_heartbeat_of_a_served_rig_is_real_time(served: Served, speed: float, written_s: float) -> None:
    """2 s, as far as the module's 16 bits of milliseconds reach."""
    assert controller(served(speed)).module.exchange(HEARTBEAT) == round(1000.0 * written_s)


@pytest.mark.endpoint
def test_a_pause_of_this_computer_stops_no_axis_of_a_fast_served_rig(served: Served) -> None:
    """Of 0.1 s, in which 6 s pass for the rig: sigma turns 120 deg meanwhile, for 12 s at least."""
    opened = served(60.0)
    move = opened.rig.start("sigma", 120.0)
    clock = opened.rig.clock
    clock.sleep_until(clock.now() + 6.0)
    wait(clock, [move])
    assert opened.rig.axes["sigma"].position_deg() == pytest.approx(120.0, abs=0.01)


@pytest.mark.parametrize(
    ("port", "keys", "speed", "expected_s"),
    [
        ("COM98", "", 1.0, 0.06),
        ("COM98", SLOW, 1.0, 0.5),
        ("COM98", KEY, 1.0, 0.1),
        ("COM98", "", 60.0, 3.6),
        (NETWORK, "", 1.0, 0.25),
        (NETWORK, SLOW, 1.0, 0.5),
        (NETWORK, KEY, 1.0, 0.1),
        (NETWORK, "", 10.0, 2.5),
        ("RFC2217://127.0.0.1:4001", "", 1.0, 0.25),
    ],
)
def test_a_reply_may_be_late_by_the_kind_of_its_port(
    write_rig: Writer, port: str, keys: str, speed: float, expected_s: float
) -> None:
    """In real time: on the clock of a served rig it is that much longer. A key of the rig file comes first."""
    simulated = "" if speed == 1.0 else f"[simulated]\nseed = 1\nspeed = {speed}"
    axes = [('port = "twin://virtual/axes"', f'port = "{port}"\n'), ("baudrate = 115200", keys)]
    with open_rig(read_rig(write_rig(("[simulated]\nseed = 1", simulated), *axes, *REAL)), VirtualClock()) as opened:
        module = controller(opened).module
        assert module.reply_s == pytest.approx(expected_s)
        with module.patiently():
            assert module.reply_s == max(expected_s, 0.5 * speed)
        assert module.reply_s == pytest.approx(expected_s)


def test_the_bounds_of_the_longest_wait_are_stated(write_rig: Writer) -> None:
    for value in ("0.01", "1.1", '"long"'):
        with pytest.raises(UserError, match=r"axes\.reply_timeout_s: "):
            read_rig(write_rig(("baudrate = 115200", f"reply_timeout_s = {value}")))
