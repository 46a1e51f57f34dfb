"""What many tests need: the example files, changed where a test wants, and virtual rigs with their drivers.

Three workers share the tests (`make test`) on two cores: one of them mostly waits, and others at times. A group of pytest-xdist
is one worker's. Those marked `endpoint` open real pseudo-terminals and sockets and wait in real time, so that two of them at
once would make each other late: they are a group, and hold a lock from setup to teardown, for another run beside this one.
The tests of a module whose fixture takes seconds are a group too, `pytestmark = pytest.mark.xdist_group("...")`. All others are
given to whichever worker has none.

Hypothesis takes its number of examples from a profile: few in `make test`, many in `make test-long`.
"""

import contextlib
import gc
import json
import logging
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from goniotwin import examples
from goniotwin.app.rig import OpenRig, RigFile, open_rig, read_rig
from goniotwin.drivers import Rig, TmclAxis
from goniotwin.drivers.motion.tmcl import TmclSettings, exchange_seconds
from goniotwin.protocols.clock import Clock, VirtualClock
from tests.sizes import few_check_rays

REPOSITORY = Path(__file__).resolve().parents[1]
RIG, SCHEDULE = examples.RIG, examples.SCHEDULE
LOG = logging.getLogger("goniotwin.compilation")
BARE_NAMES = {"app", "drivers", "examples", "mocks", "protocols", "twin"}

Change = tuple[str, str]
Writer = Callable[..., Path]
RigOpener = Callable[..., OpenRig]
ONE_WAY: Change = ("transmits = true, width_deg = 20.0", 'side = "front", transmits = true, width_deg = 20.0')
"""The opal glass of the examples as older versions took it: transparent for light from the front alone."""

SMALL = """
name = "small"
samples = ["gaussian-5"]
etalon = "etalon"
sigma_deg = [30]
beta_deg = [180]
shift_deg = [0, 1]
wavelength_nm = [550]
gains_v_per_a = [1e8, 1e10]
readings = 2
dark_readings = 4
"""

hypothesis.settings.register_profile("quick", max_examples=20, deadline=None)
hypothesis.settings.register_profile("long", max_examples=200, deadline=None)
hypothesis.settings.load_profile("quick")  # `pytest --hypothesis-profile=long` takes the other


@pytest.fixture(scope="session", autouse=True)
def silent_compiler() -> None:
    """A command within a test states nothing where a worker of the tests is the first to compile some kernel."""
    LOG.disabled = True


def pytest_configure() -> None:
    """Gives way to the first worker, and leaves out what collecting the tests does not need.

    The first worker has the tests that wait in real time, and starts programs for them: several workers on two cores must not
    make their answers late. The tests' modules stay, so that searching them for garbage is a third of the time for nothing.
    """
    if os.environ.get("PYTEST_XDIST_WORKER", "gw0") != "gw0" and sys.platform != "win32":
        os.nice(10)
    gc.disable()


def pytest_collection_finish() -> None:
    """From here on garbage is collected again, and only among what the tests make."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks whatever serves a rig as `endpoint`, and has the groups of `endpoint` and of `early` begin with the run.

    The groups are given out in the order of their first tests, so that the first worker has those of `endpoint`. What is
    `early` comes first among these, and what else is `early` is the second group.
    """
    for item in items:
        if {"serve", "forked_serve"} & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.endpoint)
        group = next((name for name in ("endpoint", "early") if item.get_closest_marker(name) is not None), None)
        if group is not None:
            item.add_marker(pytest.mark.xdist_group(group))
    items.sort(key=lambda item: [item.get_closest_marker(name) is None for name in ("endpoint", "early")])


@pytest.fixture
def heard_hangup() -> Iterator[None]:
    """SIGHUP is not ignored, as `nohup make test` would have it."""
    if sys.platform == "win32":
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Runs one test after the other where they are marked `endpoint`, whichever worker they are on."""
    with contextlib.nullcontext() if item.get_closest_marker("endpoint") is None else locked(REPOSITORY / "pyproject.toml"):
        return (yield)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Holds the lock of a file, one worker at a time. Windows has no such lock: run the tests on one worker there."""
    with path.open(encoding="utf-8") as file:
        if sys.platform != "win32":
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)  # until it is closed
        yield


def changed(text: str, changes: tuple[Change, ...]) -> str:
    """Text with parts replaced; each part must be there, so that no test goes astray in silence."""
    for old, new in changes:
        assert old in text, f"{old!r} is not in the text any more"
        text = text.replace(old, new)
    return text


@pytest.fixture
def write_rig(tmp_path: Path) -> Writer:
    """Writes the example rig with changes; returns its path."""

    def write(*changes: Change, name: str = "rig.toml") -> Path:
        path = tmp_path / name
        path.write_text(changed(RIG.read_text(encoding="utf-8"), changes), encoding="utf-8")
        return path

    return write


@pytest.fixture
def write_schedule(tmp_path: Path) -> Writer:
    """Writes a small schedule (eight rows) with changes; returns its path."""

    def write(*changes: Change, name: str = "schedule.toml", text: str = SMALL) -> Path:
        path = tmp_path / name
        path.write_text(changed(text, changes), encoding="utf-8")
        return path

    return write


@pytest.fixture
def opened(write_rig: Writer) -> Iterator[RigOpener]:
    """Opens the example rig with changes, connected; closes it after the test."""
    rigs: list[OpenRig] = []

    def open_changed(*changes: Change, clock: Clock | None = None, transcript: Path | None = None) -> OpenRig:
        description = read_rig(write_rig(*changes, name=f"rig-{len(rigs)}.toml"))
        rig = open_rig(description, clock if clock is not None else VirtualClock(), transcript)
        rigs.append(rig)
        rig.connect()
        return rig

    yield open_changed
    for rig in rigs:
        rig.close()


@pytest.fixture(scope="session")
def demo_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Folder and result of a `goniotwin demo`, made once for all workers. Tests only read it."""
    from tests.system.command import invoke, json_result

    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "demo"
    folder.mkdir(exist_ok=True)
    (folder / "lock").touch()
    with locked(folder / "lock"):
        result = folder / "result.json"
        if not result.exists():
            found = json_result(invoke("demo", "--out", folder, "--transcript", folder / "wires", "--json"))
            result.write_text(json.dumps(found), encoding="utf-8")
    return folder, json.loads(result.read_text(encoding="utf-8"))


@pytest.fixture
def quick_errors() -> Iterator[None]:
    """For tests of simulated values: their standard errors are of few rays."""
    with few_check_rays():
        yield


def tmcl_axis(rig: Rig, name: str) -> TmclAxis:
    """An axis of a TMCL module, with what other makes may not have."""
    axis = rig.axes[name]
    assert isinstance(axis, TmclAxis)
    return axis


def tmcl_exchange_s(file: RigFile) -> float:
    """Duration of an exchange with the controller of `[axes]`."""
    table = file.axes.controllers[0].table
    assert isinstance(table, TmclSettings)
    return exchange_seconds(table.baudrate)


@pytest.fixture(scope="session", autouse=True)
def _own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A state folder of the tests' own, for the programs that they start too: it has the locks of rigs."""
    folder = str(tmp_path_factory.mktemp("state"))
    with pytest.MonkeyPatch.context() as patch:
        for variable in ("XDG_STATE_HOME", "WIN_PD_OVERRIDE_LOCAL_APPDATA"):
            patch.setenv(variable, folder)
        yield


@pytest.fixture(scope="session", autouse=True)
def _no_bare_names() -> Iterator[None]:
    """No folder is imported under its bare name: from the repository's root both names work, and give different classes."""
    yield
    bare = sorted(name for name in sys.modules if name.partition(".")[0] in BARE_NAMES)
    assert not bare, f"imported without the package goniotwin: {', '.join(bare)}"
