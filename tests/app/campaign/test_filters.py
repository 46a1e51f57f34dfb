"""Order-sorting filters in a campaign: put in with the wavelength, asked for, recorded, and what they are for."""

import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.check import checked_plan
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reduction.reduction import reduce_journal
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import State
from goniotwin.app.rig import OpenRig
from goniotwin.mocks.faults import ON_A_TEXT_LINE, Fault, Script
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices import Cornerstone260
from goniotwin.twin.optics import apply_spectrum, lambertian
from tests.app.campaign.failing_campaign import POLICIES, Wires, run_with, wrong
from tests.app.campaign.filter_bench import BELIEVED, THERE, plan_with, rig_with, second_order
from tests.app.campaign.measuring_bench import Run, carried_out
from tests.app.campaign.test_resume import stopped_at, values

POSITION = {500.0: 1.0, 600.0: 4.0, 700.0: 2.0, 760.0: 2.0}
"""By wavelength, as the bench's rig file says it."""


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The lines that the monochromator hears."""
    lines: list[str] = []
    receive = Cornerstone260.receive

    def noting(unit: Cornerstone260, data: bytes, t: float) -> None:
        lines.append(data.decode("ascii", "replace").strip())
        receive(unit, data, t)

    monkeypatch.setattr(Cornerstone260, "receive", noting)
    return lines


def test_the_wheel_turns_with_the_wavelength_and_each_row_says_where_it_is(heard: list[str], tmp_path: Path) -> None:
    plan = plan_with()
    run = carried_out(plan, tmp_path / "a.journal")
    assert run.state is State.DONE
    measured = run.of("measure")
    assert {each.row.wavelength_nm for each in measured} == {500.0, 600.0, 700.0}
    for each in measured:
        assert each.row.wavelength_nm is not None
        assert each.data.positions is not None
        assert each.data.positions["filter"] == POSITION[each.row.wavelength_nm]
    # It is turned where the filter changes, and there alone: the first position is that after power-on.
    order = [POSITION[each.row.wavelength_nm or 0.0] for each in measured]
    changes = [there for here, there in zip([1.0, *order], order, strict=False) if here != there]
    assert [line for line in heard if line.startswith("FILTER ")] == [f"FILTER {each:.0f}" for each in changes]
    assert changes
    assert checked_plan(plan)["filter_changes"] == len(changes)


def test_it_is_asked_before_and_after_it_is_turned(heard: list[str], tmp_path: Path) -> None:
    carried_out(plan_with(), tmp_path / "a.journal")
    for k, line in enumerate(heard):
        if line.startswith("FILTER "):
            assert heard[k - 1] == heard[k + 1] == "FILTER?"


def test_without_the_table_nothing_asks_for_the_wheel_or_turns_it(heard: list[str], tmp_path: Path) -> None:
    run = carried_out(plan_with(rig=rig_with()), tmp_path / "a.journal")
    assert not [line for line in heard if "FILTER" in line]
    assert all("filter" not in (each.data.positions or {}) for each in run.rows)


def test_a_wheel_that_is_somewhere_else_is_not_believed(tmp_path: Path) -> None:
    rigs: list[VirtualRig] = []
    wheels: list[int] = []

    def turned_by_hand(opened: OpenRig) -> None:
        assert opened.virtual is not None
        opened.virtual.plant.wheel.set(0.0, 6.0)
        rigs.append(opened.virtual)

    def looked(_: object) -> None:
        wheels.append(rigs[0].plant.filter_position(rigs[0].clock.now()))

    run = carried_out(plan_with(wavelengths="[500]"), tmp_path / "a.journal", turned_by_hand, listeners=[looked])
    assert run.state is State.DONE
    assert wheels[0] == 6
    assert wheels[-1] == 1


def test_a_position_that_the_wheel_does_not_have_ends_the_run_with_what_the_unit_says(tmp_path: Path) -> None:
    small = ("[twin.samples.etalon]", "[twin.monochromator]\nfilters = 3\n\n[twin.samples.etalon]")
    run = carried_out(plan_with(rig=rig_with(BELIEVED, small)), tmp_path / "a.journal")
    assert run.state is State.FAILED
    assert run.faults[0].startswith("monochromator: FILTER 4: error 3, destination not allowed")
    without = ("[twin.samples.etalon]", "[twin.monochromator]\nfilters = 0\n\n[twin.samples.etalon]")
    run = carried_out(plan_with(rig=rig_with(BELIEVED, without)), tmp_path / "b.journal")
    assert run.faults == [
        "monochromator: turn the filter wheel to 1: it has no filter wheel; remove monochromator.filters from the rig file"
    ]


def test_a_unit_that_calls_it_an_error_to_be_there_already_is_never_sent_there(tmp_path: Path) -> None:
    def strict(opened: OpenRig) -> None:
        assert opened.virtual is not None
        unit = opened.virtual.serial["mono"]
        assert isinstance(unit, Cornerstone260)
        unit._statements._drive = replace(unit._statements._drive, already_there_is_error=True)

    run = carried_out(plan_with(tables=POLICIES), tmp_path / "a.journal", strict)
    assert run.state is State.DONE
    assert not run.events


def test_a_stop_while_the_wheel_turns_has_it_stop_there_and_the_campaign_goes_on_later(
    heard: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, path = plan_with(), tmp_path / "a.journal"
    run_campaign(plan, tmp_path / "whole.journal")
    heard.clear()
    rigs: list[VirtualRig] = []
    engines: list[Engine] = []
    ways: list[tuple[float, float]] = []

    def half_way(opened: OpenRig) -> None:
        assert opened.virtual is not None
        rigs.append(opened.virtual)
        wheel = opened.virtual.plant.wheel
        slew = wheel.slew

        def stopped(start: float, end: float, position: float) -> None:
            ways.append((wheel.at(start), position))
            slew(start, end, position)
            opened.rig.clock.at(start + 0.4 * (end - start), lambda: engines[0].stop())

        monkeypatch.setattr(wheel, "slew", stopped)

    run = carried_out(plan, path, half_way, made=engines.append)
    assert run.state is State.IDLE
    assert heard[-1] == "ABORT"
    plant, now = rigs[0].plant, rigs[0].clock.now()
    begun, target = ways[-1]
    assert plant.wheel.at(now) == plant.wheel.at(now + 100.0) == round(begun + 0.4 * (target - begun)) != target
    assert resume_campaign(path).state is State.DONE
    assert values(path) == values(tmp_path / "whole.journal")


def test_a_resumed_campaign_sets_the_filter_anew(tmp_path: Path) -> None:
    """The rig was off in between: its wheel is back where it is after power-on."""
    plan, path = plan_with(("shift_deg = [0, 1]", "shift_deg = [0, 1, 2]")), tmp_path / "a.journal"
    run_campaign(plan, tmp_path / "whole.journal")
    for share in (0.3, 0.45, 0.8):
        path = tmp_path / f"{share}.journal"
        stopped_at(plan, path, share * plan.seconds)
        assert resume_campaign(path).state is State.DONE
        assert values(path) == values(tmp_path / "whole.journal")
        positions = _positions(path)
        assert {position for position, _ in positions} == {1.0, 2.0, 4.0}
        assert all(position == POSITION[wavelength] for position, wavelength in positions)


def _positions(path: Path) -> list[tuple[float, float]]:
    """Of the filter, with the wavelength, by SQL."""
    database = sqlite3.connect(path)
    try:
        return database.execute(
            "SELECT json_extract(positions, '$.filter'), wavelength_nm FROM attempt JOIN plan USING (number)"
            " WHERE kind = 'measure'"
        ).fetchall()
    finally:
        database.close()


# ---- on wires that fail ----


@pytest.fixture(scope="module")
def failing() -> Plan:
    return plan_with(("shift_deg = [0, 1]", "shift_deg = [0]"), wavelengths="[500, 600]", tables=POLICIES)


@pytest.mark.parametrize("fault", ON_A_TEXT_LINE)
def test_a_fault_while_the_filter_changes_changes_nothing(
    fault: Fault, failing: Plan, heard: list[str], tmp_path: Path
) -> None:
    def connected(wires: Wires) -> None:
        found.append(wires)
        heard.clear()

    found: list[Wires] = []
    well, _ = run_with(failing, tmp_path / "well.journal", {}, broken=connected)
    assert well.state is State.DONE
    turned = heard.index("FILTER 4")
    for at in (turned - 1, turned, turned + 1):  # the question before, the order, the question after
        run, wires = run_with(
            failing, tmp_path / f"{at}.journal", {"mono": Script([Fault.NONE] * at + [fault], at)}, broken=connected
        )
        told = f"{fault} at {at}"
        assert wires.misfortunes["mono"].met == [fault], told
        assert run.state is State.DONE, (told, run.faults)
        _as_well(run, well, told)


def _as_well(run: Run, well: Run, told: str) -> None:
    assert [each.row.number for each in run.rows] == [each.row.number for each in well.rows], told
    for mine, right in zip(run.rows, well.rows, strict=True):
        assert wrong(mine, right, homed=False) == "", f"{told}: {mine.row.identity}"
        assert (mine.data.positions or {}).get("filter") == (right.data.positions or {}).get("filter"), told


def test_a_wheel_of_which_nobody_hears_any_more_ends_the_run(failing: Plan, heard: list[str], tmp_path: Path) -> None:
    run_with(failing, tmp_path / "well.journal", {}, broken=lambda _: heard.clear())
    turned = heard.index("FILTER 4")
    hang = Script([Fault.NONE] * turned + [Fault.HANG] * 100_000)
    run, _ = run_with(failing, tmp_path / "a.journal", {"mono": hang})
    assert run.state is State.FAILED
    assert run.faults[0].startswith("monochromator: ")
    assert not [each for each in run.of("measure") if each.row.wavelength_nm == 600.0]


# ---- what it is for ----

SHARE = 0.3
AT_760, AT_380 = 0.8, 0.2
"""What the sample scatters, of what an ideal diffuser does."""


def _bsdf_at_760(tmp_path: Path, *changes: tuple[str, str]) -> float:
    """Of a sample that is another colour in the violet than in the red: the mean of what may be trusted."""

    def coloured(opened: OpenRig) -> None:
        assert opened.virtual is not None
        opened.virtual.plant.model.samples["gaussian-5"] = apply_spectrum([380.0, 760.0], [AT_380, AT_760], lambertian(1.0))

    path = tmp_path / "a.journal"
    path.unlink(missing_ok=True)
    run = carried_out(plan_with(wavelengths="[760]", rig=rig_with(*changes)), path, coloured)
    assert run.state is State.DONE
    with Journal.open(path) as journal:
        points = reduce_journal(journal).samples["gaussian-5"]
    assert points.good.sum() > 10
    return float(points.bsdf[points.good].mean())


def test_without_a_filter_the_second_order_falsifies_the_bsdf_by_what_it_has_to_and_with_it_not(tmp_path: Path) -> None:
    # The twin's lamp and photodiodes (twin/plant/model.py), between the points of their tables at 650 and 780 nm.
    lamp_760, diode_760 = 0.95 - 0.05 * 110.0 / 130.0, 0.38 + 0.10 * 110.0 / 130.0
    first, second = lamp_760 * diode_760, SHARE * 0.75 * 0.10
    biased = (first * AT_760 + second * AT_380) / (first + second)
    assert biased / AT_760 == pytest.approx(0.962, abs=1e-3)
    assert _bsdf_at_760(tmp_path) == pytest.approx(AT_760 / np.pi, rel=2e-3)
    assert _bsdf_at_760(tmp_path, second_order(SHARE)) == pytest.approx(biased / np.pi, rel=2e-3)
    assert _bsdf_at_760(tmp_path, second_order(SHARE), BELIEVED, THERE) == pytest.approx(AT_760 / np.pi, rel=2e-3)
    # What the operator believes to stand in the wheel does not help where there is nothing.
    assert _bsdf_at_760(tmp_path, second_order(SHARE), BELIEVED) == pytest.approx(biased / np.pi, rel=2e-3)
