"""Device kinds of installed packages: loading by role and name, the messages about faulty ones, the schema."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from goniotwin.app.rig import kinds as registry
from goniotwin.app.rig import read_rig
from tests.conftest import Change, Writer

CODE = """
from dataclasses import dataclass, replace
from typing import Literal
from goniotwin.app.rig.axes import AnyAxis, AxesTable
from goniotwin.app.rig.kinds import device_kind, motion_kind
from goniotwin.app.rig.makes import MonitorTable
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.drivers.motion.tmcl import TmclSettings
from goniotwin.keys import Positive

@dataclass(frozen=True, kw_only=True)
class Table(MonitorTable):
    kind: Literal["mine"]

@dataclass(frozen=True, kw_only=True)
class Axes(AxesTable[AnyAxis], TmclSettings):
    kind: Literal["{name}"]
    port: str

@dataclass(frozen=True, kw_only=True)
class OwnAxis(AxisSettings, TmclSettings):
    kind: Literal["{name}"]
    port: str
    ramp_s: Positive = 0.5

KIND = {kind}
"""
MOTION = 'replace(motion_kind("tmcl"), name="mine", axes=Axes, own_axis=OwnAxis, twins=())'
MONITOR = 'replace(device_kind("monitor", "pm100d"), name="mine", table=Table)'
OF_SHIFT: Change = ("[axes.shift] ", '[axes.shift]\nkind = "mine"\nport = "twin://virtual/second"\n#')
TWIN: Change = ("[twin.light]\n", '[twin.controllers.second]\nkind = "tmcm-1240"\naxes = ["shift"]\n\n[twin.light]\n')


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    """The registered kinds are those of before."""
    before = registry.kinds()
    yield
    for kind in registry.kinds():
        if kind not in before:
            registry.unregister(kind)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which Python finds installed packages."""
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def install(folder: Path, package: str, kind: str, name: str = "mine") -> None:
    """A package with a module and an entry point of the group, as an installer leaves it."""
    sys.modules.pop(package, None)
    (folder / f"{package}.py").write_text(CODE.format(kind=kind, name=name), encoding="utf-8")
    about = folder / f"{package}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(f"[{registry.GROUP}]\n{name} = {package}:KIND\n", encoding="utf-8")


def test_a_rig_file_with_the_kind_of_an_installed_package_is_read(folder: Path, write_rig: Writer) -> None:
    install(folder, "motion_package", MOTION)
    assert read_rig(write_rig()).file.name == "virtual goniophotometer"
    with pytest.raises(KeyError):
        registry.motion_kind("mine")  # no rig needed it
    file = read_rig(write_rig(OF_SHIFT, TWIN)).file
    assert [each.kind.name for each in file.axes.controllers] == ["tmcl", "mine"]
    assert registry.motion_kind("mine").open is registry.motion_kind("tmcl").open


def test_the_own_key_of_such_a_kind_is_read_bounded_and_suggested(folder: Path, write_rig: Writer) -> None:
    install(folder, "motion_package", MOTION)

    def read(line: str) -> Any:
        return read_rig(write_rig((OF_SHIFT[0], OF_SHIFT[1].replace("#", f"{line}\n#")), TWIN)).file.axes.shift

    assert (read("").ramp_s, read("ramp_s = 2").ramp_s) == (0.5, 2.0)
    with pytest.raises(UserError, match=r"axes\.shift\.ramp_s: input should be greater than 0, not -1"):
        read("ramp_s = -1")
    with pytest.raises(UserError, match=r"axes\.shift\.rampe_s: there is no such key; did you mean 'ramp_s'\?"):
        read("rampe_s = 1")


def test_tables_of_axes_that_take_axes_of_no_other_kind_are_refused(folder: Path, write_rig: Writer) -> None:
    install(folder, "motion_package", MOTION.replace("axes=Axes,", "axes=OwnAxis,"))
    with pytest.raises(UserError, match=r"cannot be loaded .* axes: OwnAxis does not leave the type of its axes open; extend"):
        read_rig(write_rig(OF_SHIFT, TWIN))


def test_a_kind_is_loaded_where_another_role_has_one_of_that_name(folder: Path, write_rig: Writer) -> None:
    install(folder, "motion_package", MOTION.replace("mine", "pm100d"), "pm100d")
    file = read_rig(write_rig((OF_SHIFT[0], OF_SHIFT[1].replace("mine", "pm100d")), TWIN)).file
    assert [each.kind.name for each in file.axes.controllers] == ["tmcl", "pm100d"]


def test_an_entry_point_of_another_name_than_its_kind_is_named(folder: Path, write_rig: Writer) -> None:
    install(folder, "motion_package", MOTION.replace("mine", "esp"))
    with pytest.raises(
        UserError, match=r"'mine' cannot be loaded .* motion_package: .* the kind 'esp'; both need the same name"
    ):
        read_rig(write_rig(OF_SHIFT, TWIN))


def test_an_unknown_kind_suggests_those_of_its_role_and_another_package(folder: Path, write_rig: Writer) -> None:
    install(folder, "motion_package", MOTION)
    install(folder, "broken_package", "1 / 0", "broken")
    for change, listed in (
        ((OF_SHIFT[0], OF_SHIFT[1].replace("mine", "esp")), "'broken' or 'mine' or 'tmcl'"),
        (('kind = "pm100d"', 'kind = "esp"'), "'broken' or 'pm100d'"),
    ):
        with pytest.raises(UserError, match=f"give {listed}, or install the package that has this kind"):
            read_rig(write_rig(change))


@pytest.mark.parametrize("fault", ["KeyError('number')", "AttributeError('number')"])
def test_any_error_in_the_check_of_a_kind_is_a_message(folder: Path, write_rig: Writer, fault: str) -> None:
    check = f"lambda axes: (_ for _ in ()).throw({fault})"
    install(folder, "motion_package", MOTION.replace("twins=()", f"twins=(), check={check}"))
    with pytest.raises(UserError, match=r"the check of the kind 'mine' fails: \w+Error: .*number.*; correct shift, or update"):
        read_rig(write_rig(OF_SHIFT, TWIN))


def test_the_schema_has_the_kinds_of_installed_packages_and_names_a_broken_one(folder: Path) -> None:
    install(folder, "monitor_package", MONITOR)
    install(folder, "broken_package", "1 / 0", "broken")
    printed = CliRunner().invoke(app, ["schema", "rig"])
    assert json.loads(printed.stdout)["$defs"]["Table"]["properties"]["kind"]["const"] == "mine"
    assert "'broken' cannot be loaded from the package broken_package: ZeroDivisionError" in printed.stderr
