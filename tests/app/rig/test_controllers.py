"""Axes with motion controllers of their own: the rig file, the drivers, the virtual rig; the registry of kinds."""

from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
import tomlkit

from goniotwin.app.cli.work.device_search import find_devices
from goniotwin.app.cli.work.referencing import home_axes
from goniotwin.app.cli.work.replay import replay_transcripts
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, OpenRig, open_rig, parse_rig, read_rig
from goniotwin.app.rig import kinds as registry
from goniotwin.app.rig.described_twin import described_twin
from goniotwin.app.rig.file import tables_without_ports
from goniotwin.app.rig.served_file import served_rig
from goniotwin.app.rig.wires import Wires
from goniotwin.drivers import wait
from goniotwin.drivers.errors import Forgotten
from goniotwin.drivers.motion.tmcl import CANARY
from goniotwin.mocks.control import ControlClient
from goniotwin.mocks.served import ServedRig
from goniotwin.protocols.clock import RealClock, VirtualClock
from goniotwin.twin.devices import TmclLine
from tests.app.test_referencing import HOMES
from tests.conftest import RIG, Change, RigOpener, Writer, changed

OWN: Change = (
    "[axes.shift]                            # the arc's polar shift\n",
    '[axes.shift]\nkind = "tmcl"\nport = "twin://virtual/second"\nbaudrate = 57600\n',
)
"""The shift's own TMCL module on a second port."""
TWIN: Change = (
    "[twin.light]\n",
    '[twin.controllers.second]\nkind = "tmcm-1240"\nbaudrate = 57600\naxes = ["shift"]\n\n[twin.light]\n',
)
OTHER = '[twin.controllers.second]\nkind = "tmcm-1240"\naxes = ["shift"]\n'
TWO = (OWN, TWIN)
SHARED: Change = (
    "[axes]\n" + RIG.read_text(encoding="utf-8").partition("[axes]\n")[2].partition("\n\n")[0] + "\n\n",
    "",
)
"""The table [axes] itself."""


def without_twin() -> str:
    """The operator's part of the example rig, with the shift's own module, on real ports."""
    text = changed(RIG.read_text(encoding="utf-8"), (OWN, *((f"twin://virtual/{old}", new) for old, new in PORTS)))
    return text.partition("# ---- what the virtual rig is")[0].replace("[simulated]\nseed = 1\n", "")


PORTS = (
    ("axes", "/dev/ttyS20"),
    ("second", "/dev/ttyS21"),
    ("mono", "/dev/ttyS22"),
    ("monitor", "1313:8078"),
    *((f"adc-{k}", f"10.0.0.{k}") for k in range(5)),
)


def test_two_modules_on_two_ports_move_home_and_read_back(opened: RigOpener, tmp_path: Path) -> None:
    rig = opened(*TWO, transcript=tmp_path / "wires")
    assert rig.virtual is not None
    targets = {"gamma": 90.0, "sigma": 45.0, "beta": 123.0, "shift": 2.5}
    wait(rig.rig.clock, [rig.rig.start(name, target) for name, target in targets.items()])
    for name, target in targets.items():
        assert rig.virtual.plant.angle_deg(name, rig.rig.clock.now()) == pytest.approx(target, abs=1e-3)
        assert rig.rig.axes[name].read_back()[0] == pytest.approx(target, abs=1e-3)
    assert list(rig.rig.axes) == list(targets)
    assert rig.rig.identities["axes"] == "TMCM-6214"
    assert rig.rig.identities["axes-shift"] == "TMCM-1240"
    assert {each.stem for each in (tmp_path / "wires").iterdir()} >= {"axes", "axes-shift"}


def test_a_reset_of_one_controller_makes_its_axes_unreferenced_and_reconnects_it_alone(opened: RigOpener) -> None:
    rig = opened(*TWO)
    assert rig.virtual is not None
    second = rig.virtual.serial["second"]
    assert isinstance(second, TmclLine)
    second.reset(rig.rig.clock.now())
    with pytest.raises(Forgotten, match=r"axes-shift.*module 1"):
        rig.rig.axes["shift"].position_deg()
    assert [name for name, axis in rig.rig.axes.items() if axis.unreferenced_reason] == ["shift"]
    controllers = {each.name: each for each in rig.rig.controllers}
    controllers["axes"].close()
    rig.rig.reconnect("shift")  # would fail if it touched the other one
    assert rig.rig.axes["shift"].position_deg() == 0.0
    assert rig.rig.device("gamma").name == "axes"
    assert rig.rig.device("photodiodes module 2").name == "photodiodes"


def test_one_device_that_does_not_respond_is_listed_and_the_others_connect(opened: RigOpener, write_rig: Writer) -> None:
    found = find_devices(write_rig(*TWO, ("twin://virtual/second", "twin://virtual/third")))
    assert [each.address for each in found] == ["axes", "axes-shift", "monochromator", "photodiodes", "monitor"]
    assert [each.address for each in found if each.tried] == ["axes-shift"]


def test_axes_of_one_port_share_a_controller(write_rig: Writer) -> None:
    table = "[axes.beta]                             # the arc about the vertical axis\n"
    beta = (table, OWN[1].replace("axes.shift", "axes.beta"))
    both = (TWIN[0], TWIN[1].replace('["shift"]', '["beta", "shift"]').replace("1240", "6214"))
    file = read_rig(write_rig(OWN, beta, both)).file
    assert [(each.name, list(each.axes)) for each in file.axes.controllers] == [
        ("axes", ["gamma", "sigma"]),
        ("axes-beta", ["beta", "shift"]),
    ]
    slower = (beta[0], beta[1].replace("57600", "9600"))
    with pytest.raises(UserError, match=r"shift\.baudrate: differs from that of axes\.beta, which has the same port"):
        read_rig(write_rig(OWN, slower))
    with pytest.raises(UserError, match=r"axes: beta and shift are both motor 0 of module 1"):
        read_rig(write_rig(OWN, beta, ("motor = 5\ngear", "motor = 0\ngear")))


def test_axes_that_all_have_their_own_controllers_need_no_kind_of_axes(write_rig: Writer) -> None:
    own = [(f"[axes.{name}] ", f'[axes.{name}]\nkind = "tmcl"\nport = "twin://virtual/{name}"\n#') for name in AXES]
    file = read_rig(write_rig(SHARED, *own)).file
    assert [each.name for each in file.axes.controllers] == [f"axes-{name}" for name in AXES]
    with pytest.raises(UserError, match=r"axes\.kind: is missing; add it"):
        read_rig(write_rig(SHARED, *own[1:]))
    with pytest.raises(UserError, match=r"axes\.port: every axis has a controller of its own.*remove kind and port"):
        read_rig(write_rig(*own))
    with pytest.raises(UserError, match=r"axes\.baudrate: every axis has a controller of its own.*remove baudrate"):
        read_rig(write_rig((SHARED[0], "[axes]\nbaudrate = 9600\n\n"), *own))


def test_the_controller_of_axes_is_named_axes_whichever_axis_has_its_port_too(write_rig: Writer) -> None:
    gamma = ("[axes.gamma] ", '[axes.gamma]\nkind = "tmcl"\nport = "twin://virtual/axes"\n#')
    assert [each.name for each in read_rig(write_rig(gamma)).file.axes.controllers] == ["axes"]


def test_two_axes_of_a_further_line_need_two_motors(write_rig: Writer) -> None:
    both = (TWIN[0], TWIN[1].replace('["shift"]', '["beta", "shift"]').replace("1240", "6214"))
    beta = ("beta = { motor = 5,", "beta = { motor = 0,")
    with pytest.raises(UserError, match=r"twin\.axes: motor 0 turns 2 axes of module 1; give each axis its own motor"):
        read_rig(write_rig(both, beta))


def test_two_names_of_one_port_are_refused(tmp_path: Path) -> None:
    """Otherwise two drivers would use one line without a lock between them."""
    (tmp_path / "tty").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "tty")
    text = without_twin().replace("/dev/ttyS20", str(tmp_path / "tty")).replace("/dev/ttyS21", str(tmp_path / "by-id"))
    with pytest.raises(UserError, match=r"real: axes\.shift\.port: .*by-id is the same line as .*tty of axes; write both"):
        open_rig(parse_rig(text, Path(), "real"), VirtualClock())
    windows = without_twin().replace("/dev/ttyS20", "COM4").replace("/dev/ttyS21", "com4")
    with pytest.raises(UserError, match=r"axes\.shift\.port: com4 is the same line as COM4 of axes"):
        open_rig(parse_rig(windows, Path(), "real"), VirtualClock())


def test_a_twin_without_the_second_controller_of_a_real_rig_is_refused() -> None:
    text = without_twin() + "[simulated]\n\n[twin]" + RIG.read_text(encoding="utf-8").partition("\n[twin]")[2]
    with pytest.raises(UserError, match=r"real: twin\.controllers: has no table for axes-shift, .* add one with the axes of"):
        described_twin(parse_rig(text, Path(), "real"), "etalon", ["gaussian-5"], {})


def test_what_is_no_table_or_has_no_model_is_named() -> None:
    document = tomlkit.parse(RIG.read_text(encoding="utf-8")).unwrap()
    with pytest.raises(UserError, match=r"rig\.toml: axes: should be a table, not 5$"):
        parse_rig(tomlkit.dumps({**document, "axes": 5}), Path(), "rig.toml")
    document["twin"]["samples"]["paper"] = {}
    with pytest.raises(UserError, match=r"rig\.toml: twin\.samples\.paper\.model: is missing; add it$"):
        parse_rig(tomlkit.dumps(document), Path(), "rig.toml")


def test_home_connects_the_controller_of_the_axis_alone(write_rig: Writer) -> None:
    """The second controller is not there: homing sigma must not need it."""
    gone = ("twin://virtual/second", "twin://virtual/third")
    lines: list[str] = []
    home_axes(write_rig(*TWO, gone, *HOMES), ["sigma"], lines.append)
    assert [line.partition(",")[0] for line in lines] == ["sigma: homed"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('kind = "tmcl"', 'kind = "tmlc"'), r"axes\.kind: 'tmlc' is not a known kind of device; for \[axes\] give 'tmcl'"),
        (('kind = "cornerstone"', 'kind = "x"'), r"monochromator\.kind: 'x' is not a known .* give 'cornerstone'"),
        ((OWN[0], OWN[1].replace("tmcl", "esp")), r"axes\.shift\.kind: 'esp' is not a known kind of device; .* give 'tmcl'"),
        ((OWN[0], '[axes.shift]\nkind = "tmcl"\n'), r"axes\.shift\.port: is missing; add it"),
        ((OWN[0], f"{OWN[1]}heartbeat = 1.0\n"), r"axes\.shift\.heartbeat: there is no such key; did you mean 'heartbeat_s'\?"),
        (
            (TWIN[0], TWIN[1].replace("1240", "1")),
            r"controllers\.second\.kind: 'tmcm-1' is .* 'tmcm-1240' or 'tmcm-6214'",
        ),
        ((TWIN[0], TWIN[1].replace('"shift"', '"delta"')), r"twin\.controllers\.second\.axes: delta is no axis; correct axes"),
        ((TWIN[0], OTHER + TWIN[1].replace("second", "third")), r"controllers\.third\.axes: shift has a second controller"),
        (('kind = "tmcl"', 'kind = ["tmcl"]'), r"axes\.kind: \['tmcl'\] is not a known kind"),
        (('kind = "pm100d"', "kind = {}"), r"monitor\.kind: \{\} is not a known kind"),
        (('kind = "adam-6017"', "kind = []"), r"photodiodes\.kind: \[\] is not a known kind"),
        ((TWIN[0], TWIN[1].replace('kind = "tmcm-1240"\n', "")), r"twin\.controllers\.second\.kind: is missing; add it"),
        ((TWIN[0], TWIN[1].replace('"tmcm-1240"', '["x"]')), r"twin\.controllers\.second\.kind: \['x'\] is not a known kind"),
        ((TWIN[0], "[twin.controllers]\nsecond = 5\n" + TWIN[0]), r"twin\.controllers\.second: should be a table, not 5"),
        ((OWN[0], OWN[1].replace('kind = "tmcl"\n', "")), r"axes\.shift\.kind: is missing; add it, because port is a key of"),
        ((OWN[0], OWN[0] + "baudrate = 9600\n"), r"axes\.shift\.kind: is missing; add it, because baudrate is a key of"),
        ((TWIN[0], TWIN[1].replace('["shift"]', "[]")), r"controllers\.second\.axes: a controller needs an axis; name one"),
        (
            (TWIN[0], TWIN[1].replace('"shift"', '"beta"')),
            r"twin\.axes\.beta: a tmcm-1240 has 1 motor, so there is no motor 5; .* controllers\.second\.kind",
        ),
        ((TWIN[0], TWIN[1].replace("second", "mono")), r"twin\.controllers: mono is the name of another device"),
        ((TWIN[0], TWIN[1].replace("second", "adc-1")), r"twin\.controllers: adc-1 is the name of another device"),
        (
            (TWIN[0], TWIN[1].replace("second", "axes")),
            r"twin\.controllers: axes is the controller of gamma, sigma, beta; give",
        ),
        (
            (TWIN[0], TWIN[1].replace("second", '"a/b"')),
            r"twin\.controllers: 'a/b' is no name of a device; give one of letters",
        ),
        ((TWIN[0], "[twin.devices.mono]\n\n" + TWIN[0]), r"twin\.devices\.mono\.kind: is missing; add it"),
        ((TWIN[0], "[twin.devices]\nmono = 5\n\n" + TWIN[0]), r"twin\.devices\.mono: should be a table, not 5"),
    ],
)
def test_an_error_in_a_kind_names_its_place(write_rig: Writer, change: Change, message: str) -> None:
    with pytest.raises(UserError, match=message):
        read_rig(write_rig(change))


def test_a_twin_with_one_controller_has_the_hash_of_before_and_further_ones_have_another(write_rig: Writer) -> None:
    one, two = (read_rig(write_rig(*changes)).model_hashes() for changes in ((), TWO))
    assert len(one) == 2
    assert len(two) == 1  # no older version can have such a model
    assert one[0] != two[0]
    other = read_rig(write_rig(OWN, (TWIN[0], TWIN[1].replace("57600", "9600")))).model_hashes()
    assert other != two


def test_the_port_of_each_controller_may_change_before_a_resume_and_nothing_else(write_rig: Writer) -> None:
    operator = OWN[1]
    port, speed = operator.replace("virtual/second", "virtual/axes-2"), operator.replace("57600", "9600")
    one, moved, slower = (
        tables_without_ports(read_rig(write_rig((OWN[0], each), TWIN)).file) for each in (operator, port, speed)
    )
    assert one == moved
    assert one != slower


def test_a_real_rig_with_two_controllers_is_described_as_a_twin() -> None:
    real = parse_rig(without_twin(), Path(), "real")
    twin = described_twin(real, "etalon", ["sample"], {}).rig
    assert {each.twin for each in twin.file.devices} == {
        "axes",
        "axes-shift",
        "mono",
        "monitor",
        *(f"adc-{k}" for k in range(5)),
    }
    with open_rig(twin, VirtualClock()) as opened:
        opened.connect()
        wait(opened.rig.clock, [opened.rig.start("shift", 3.0)])
        assert opened.virtual is not None
        assert opened.virtual.plant.angle_deg("shift", opened.rig.clock.now()) == pytest.approx(3.0, abs=1e-3)


def test_the_transcripts_of_both_controllers_replay(opened: RigOpener, write_rig: Writer, tmp_path: Path) -> None:
    rig = opened(*TWO, ("noise = true", "noise = false"), transcript=tmp_path)
    wait(rig.rig.clock, [rig.rig.start("shift", 1.0), rig.rig.start("gamma", 10.0)])
    rig.close()
    quiet = read_rig(write_rig(*TWO, ("noise = true", "noise = false")))
    result = replay_transcripts([tmp_path / "axes.txt", tmp_path / "axes-shift.txt"], quiet, None, None)
    assert result.requests > 20
    assert result.differences == []


@pytest.fixture
def served(write_rig: Writer, tmp_path: Path) -> Iterator[tuple[OpenRig, ControlClient]]:
    """The drivers of a served rig with two controllers, by the rig file that is written for it."""
    description = read_rig(write_rig(*TWO, ("noise = true", "noise = false")))
    model = description.model()
    assert model is not None
    server = ServedRig(model, 1.0, tmp_path / "ptys")
    server.start()
    assert {each.device: each.kind for each in server.endpoints}["second"] == "tmcm-1240"
    control = ControlClient(server.endpoints[-1].port or 0, server.endpoints[-1].token or "")
    with open_rig(parse_rig(served_rig(description, server.endpoints, 1.0), tmp_path, "served.toml"), RealClock()) as opened:
        yield opened, control
    control.close()
    server.stop()


@pytest.mark.long
@pytest.mark.endpoint
def test_a_served_rig_has_the_second_controller_with_its_plug_and_faults(served: tuple[OpenRig, ControlClient]) -> None:
    opened, control = served
    opened.connect()
    control.do("faults", device="second", script=["lost"])
    assert opened.rig.axes["shift"].position_deg() == 0.0
    assert control.do("faults", device="second", script=["none"])["met"] == ["lost"]
    control.do("unplug", device="second")
    outcome = opened.rig.connect()
    assert [name for name, error in outcome.items() if error is not None] == ["axes-shift"]
    control.do("replug", device="second")
    opened.rig.reconnect("axes-shift")
    assert opened.rig.axes["shift"].position_deg() == 0.0


def test_a_broken_plug_in_is_named_and_stops_only_rigs_that_need_it(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = EntryPoint("esp", "a_package_that_is_not_there.driver:ESP", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [broken])
    assert read_rig(write_rig()).file.name == "virtual goniophotometer"
    with pytest.raises(
        UserError, match=r"'esp' cannot be loaded from the package a_package.*ModuleNotFoundError.*update or remove"
    ):
        read_rig(write_rig((OWN[0], OWN[1].replace("tmcl", "esp"))))
    with pytest.raises(UserError, match=r"for \[axes\] give 'esp' or 'tmcl'"):
        read_rig(write_rig((OWN[0], OWN[1].replace("tmcl", "x"))))


def test_a_kind_is_registered_once() -> None:
    tmcl = registry.motion_kind("tmcl")
    registry.register(tmcl)
    with pytest.raises(ValueError, match="there is a kind 'tmcl' of axes already"):
        registry.register(replace(tmcl, probes=()))


def test_the_session_has_a_number_of_its_own_except_on_the_virtual_rig(opened: RigOpener) -> None:
    """All bytes of the virtual rig are the same in each run."""
    virtual = opened().virtual
    numbers = [Wires(VirtualClock(), None, None).session for _ in range(3)]
    assert len({*numbers, 0, CANARY}) == 5
    assert all(0 < each < 2**31 for each in numbers)
    assert Wires(VirtualClock(), virtual, None).session == CANARY
