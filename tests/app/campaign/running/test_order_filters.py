"""Order filters in a campaign: set with the wavelength, checked, recorded, and their effect on the BSDF."""

import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import OpenRig
from goniotwin.mocks.faults import ON_A_TEXT_LINE, Fault, ScriptedFaults
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices import Cornerstone260
from goniotwin.twin.optics import apply_spectrum, lambertian
from tests.app.campaign.campaign_bench import RunResult, planned_values, run_plan, run_until
from tests.app.campaign.filter_rig import RIG_FILTERS, TWIN_FILTERS, plan_with, rig_with, second_order
from tests.app.campaign.running.faulty_campaign import POLICIES, row_difference, run_with_faults

pytestmark = pytest.mark.xdist_group("order filters")

POSITION = {500.0: 1.0, 600.0: 4.0, 700.0: 2.0, 760.0: 2.0}
"""Position of the filter wheel by wavelength, as in the rig file of the bench."""


def record_lines(patch: pytest.MonkeyPatch) -> list[str]:
    """Lines that the monochromator receives from now on."""
    lines: list[str] = []
    receive = Cornerstone260.receive

    def record(unit: Cornerstone260, data: bytes, t: float) -> None:
        lines.append(data.decode("ascii", "replace").strip())
        receive(unit, data, t)

    patch.setattr(Cornerstone260, "receive", record)
    return lines


@pytest.fixture
def received(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Lines that the monochromator receives."""
    return record_lines(monkeypatch)


def test_the_filter_wheel_turns_with_the_wavelength_and_each_row_has_its_position(received: list[str], tmp_path: Path) -> None:
    plan = plan_with()
    run = run_plan(plan, tmp_path / "a.journal")
    assert run.state is State.DONE
    measured = run.of("measure")
    assert {each.row.wavelength_nm for each in measured} == {500.0, 600.0, 700.0}
    for each in measured:
        assert each.row.wavelength_nm is not None
        assert each.data.positions is not None
        assert each.data.positions["filter"] == POSITION[each.row.wavelength_nm]
    # The wheel turns only where the filter changes; its first position is that after power-on.
    order = [POSITION[each.row.wavelength_nm or 0.0] for each in measured]
    changes = [after for before, after in zip([1.0, *order], order, strict=False) if before != after]
    assert [line for line in received if line.startswith("FILTER ")] == [f"FILTER {each:.0f}" for each in changes]
    assert changes
    assert check_plan(plan).filter_changes == len(changes)


def test_the_position_is_queried_before_and_after_a_turn(received: list[str], tmp_path: Path) -> None:
    run_plan(plan_with(), tmp_path / "a.journal")
    for k, line in enumerate(received):
        if line.startswith("FILTER "):
            assert received[k - 1] == received[k + 1] == "FILTER?"


def test_without_a_table_of_filters_the_wheel_is_not_used(received: list[str], tmp_path: Path) -> None:
    run = run_plan(plan_with(rig=rig_with()), tmp_path / "a.journal")
    assert not [line for line in received if "FILTER" in line]
    assert all("filter" not in (each.data.positions or {}) for each in run.rows)


def test_a_wheel_at_another_position_is_turned(tmp_path: Path) -> None:
    rigs: list[VirtualRig] = []
    wheels: list[int] = []

    def turn_by_hand(opened: OpenRig) -> None:
        assert opened.virtual is not None
        opened.virtual.plant.wheel.set(0.0, 6.0)
        rigs.append(opened.virtual)

    def look(_: object) -> None:
        wheels.append(rigs[0].plant.filter_position(rigs[0].clock.now()))

    run = run_plan(plan_with(wavelengths="[500]"), tmp_path / "a.journal", turn_by_hand, listeners=[look])
    assert run.state is State.DONE
    assert wheels[0] == 6
    assert wheels[-1] == 1


def test_a_position_that_the_wheel_does_not_have_ends_the_run_with_the_error_of_the_unit(tmp_path: Path) -> None:
    small = ("[twin.samples.etalon]", "[twin.monochromator]\nfilters = 3\n\n[twin.samples.etalon]")
    run = run_plan(plan_with(rig=rig_with(RIG_FILTERS, small)), tmp_path / "a.journal")
    assert run.state is State.FAILED
    assert run.faults[0].startswith("Monochromator (Cornerstone 260) has refused a command: ")
    assert run.faults[0].endswith("(FILTER 4: error 3, destination not allowed)")
    without = ("[twin.samples.etalon]", "[twin.monochromator]\nfilters = 0\n\n[twin.samples.etalon]")
    run = run_plan(plan_with(rig=rig_with(RIG_FILTERS, without)), tmp_path / "b.journal")
    assert run.faults == [
        "monochromator: turn the filter wheel to 1: it has no filter wheel; remove monochromator.filters from the rig file"
    ]


def test_a_unit_with_an_error_for_its_current_position_is_not_sent_there(tmp_path: Path) -> None:
    def make_strict(opened: OpenRig) -> None:
        assert opened.virtual is not None
        plant = opened.virtual.plant
        plant.model = replace(plant.model, monochromator=replace(plant.model.monochromator, already_there_is_error=True))
        opened.virtual.serial["mono"] = Cornerstone260(plant)
        opened.rig.monochromator.connect()

    run = run_plan(plan_with(tables=POLICIES), tmp_path / "a.journal", make_strict)
    assert run.state is State.DONE
    assert not run.events


def test_a_stop_stops_the_turning_wheel_and_the_campaign_can_be_resumed(
    received: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, path = plan_with(), tmp_path / "a.journal"
    run_campaign(plan, tmp_path / "whole.journal")
    received.clear()
    rigs: list[VirtualRig] = []
    engines: list[Engine] = []
    turns: list[tuple[float, float]] = []

    def stop_halfway(opened: OpenRig) -> None:
        assert opened.virtual is not None
        rigs.append(opened.virtual)
        wheel = opened.virtual.plant.wheel
        slew = wheel.slew

        def slew_and_stop(start: float, end: float, position: float) -> None:
            turns.append((wheel.at(start), position))
            slew(start, end, position)
            opened.rig.clock.at(start + 0.4 * (end - start), lambda: engines[0].stop())

        monkeypatch.setattr(wheel, "slew", slew_and_stop)

    run = run_plan(plan, path, stop_halfway, use_engine=engines.append)
    assert run.state is State.IDLE
    moving = [each for each in received if each.startswith(("GOWAVE ", "FILTER ", "SHUTTER ", "ABORT"))]
    assert moving[-2:] == ["ABORT", "SHUTTER C"]
    plant, now = rigs[0].plant, rigs[0].clock.now()
    first, target = turns[-1]
    assert plant.wheel.at(now) == plant.wheel.at(now + 100.0) == round(first + 0.4 * (target - first)) != target
    assert resume_campaign(path).state is State.DONE
    assert planned_values(path) == planned_values(tmp_path / "whole.journal")


@pytest.mark.parametrize(
    "shares", [pytest.param((0.45,), id="one"), pytest.param((0.3, 0.8), id="two", marks=pytest.mark.long)]
)
def test_a_resumed_campaign_sets_the_filter_again(shares: tuple[float, ...], tmp_path: Path) -> None:
    """The rig was off meanwhile: its wheel is at the position after power-on."""
    plan, path = plan_with(("shift_deg = [0, 1]", "shift_deg = [0, 1, 2]")), tmp_path / "a.journal"
    run_campaign(plan, tmp_path / "whole.journal")
    for share in shares:
        path = tmp_path / f"{share}.journal"
        run_until(plan, path, share * plan.seconds)
        assert resume_campaign(path).state is State.DONE
        assert planned_values(path) == planned_values(tmp_path / "whole.journal")
        positions = _positions(path)
        assert {position for position, _ in positions} == {1.0, 2.0, 4.0}
        assert all(position == POSITION[wavelength] for position, wavelength in positions)


def _positions(path: Path) -> list[tuple[float, float]]:
    """Positions of the filter wheel with the wavelengths, read with SQL."""
    database = sqlite3.connect(path)
    try:
        return database.execute(
            "SELECT json_extract(positions, '$.filter'), wavelength_nm FROM attempt JOIN plan USING (number)"
            " WHERE kind = 'measure'"
        ).fetchall()
    finally:
        database.close()


# ---- wires that fail ----


@pytest.fixture(scope="session")
def two_filters() -> Plan:
    return plan_with(("shift_deg = [0, 1]", "shift_deg = [0]"), wavelengths="[500, 600]", tables=POLICIES)


@pytest.fixture(scope="session")
def undisturbed(two_filters: Plan, tmp_path_factory: pytest.TempPathFactory) -> tuple[RunResult, int]:
    """The run without a fault, and the exchange in which the monochromator gets the command to turn the wheel."""
    with pytest.MonkeyPatch.context() as patch:
        lines = record_lines(patch)
        path = tmp_path_factory.mktemp("undisturbed") / "a.journal"
        run, _ = run_with_faults(two_filters, path, {}, use_wires=lambda _: lines.clear())
    assert run.state is State.DONE
    return run, lines.index("FILTER 4")


PLACES = (-1, 0, 1)
"""The query before the command to turn the wheel, the command, the query after."""
ONE_PLACE = [pytest.param(fault, PLACES[k % 3 :][:1], id=str(fault)) for k, fault in enumerate(ON_A_TEXT_LINE)]
ALL_PLACES = [pytest.param(fault, PLACES, id=f"{fault}, all places", marks=pytest.mark.long) for fault in ON_A_TEXT_LINE]


@pytest.mark.parametrize(("fault", "places"), ONE_PLACE + ALL_PLACES)
def test_a_fault_during_a_filter_change_changes_no_row(
    fault: Fault, places: tuple[int, ...], two_filters: Plan, undisturbed: tuple[RunResult, int], tmp_path: Path
) -> None:
    expected, turned = undisturbed
    for place in places:
        at = turned + place
        run, wires = run_with_faults(
            two_filters, tmp_path / f"{at}.journal", {"mono": ScriptedFaults([Fault.NONE] * at + [fault], at)}
        )
        context = f"{fault} at {at}"
        assert wires.fault_plans["mono"].met == [fault], context
        assert run.state is State.DONE, (context, run.faults)
        _check_rows(run, expected, context)


def _check_rows(run: RunResult, expected: RunResult, context: str) -> None:
    assert [each.row.number for each in run.rows] == [each.row.number for each in expected.rows], context
    for mine, right in zip(run.rows, expected.rows, strict=True):
        assert row_difference(mine, right, homed=False) == "", f"{context}: {mine.row.identity}"
        assert (mine.data.positions or {}).get("filter") == (right.data.positions or {}).get("filter"), context


def test_a_wheel_that_does_not_respond_ends_the_run(
    two_filters: Plan, undisturbed: tuple[RunResult, int], tmp_path: Path
) -> None:
    hang = ScriptedFaults([Fault.NONE] * undisturbed[1] + [Fault.HANG] * 100_000)
    run, _ = run_with_faults(two_filters, tmp_path / "a.journal", {"mono": hang})
    assert run.state is State.FAILED
    assert run.faults[0].startswith("Monochromator (Cornerstone 260) is not responding: switch it on, also from standby; ")
    assert not [each for each in run.of("measure") if each.row.wavelength_nm == 600.0]


# ---- second order of the grating ----

SHARE = 0.3
AT_760, AT_380 = 0.8, 0.2
"""Reflectance of the sample, relative to an ideal diffuser."""


def _bsdf_at_760(tmp_path: Path, *changes: tuple[str, str]) -> float:
    """Mean BSDF at 760 nm of a sample with another reflectance at 380 nm, over the points without flags."""

    def set_spectrum(opened: OpenRig) -> None:
        assert opened.virtual is not None
        opened.virtual.plant.model.samples["gaussian-5"] = apply_spectrum([380.0, 760.0], [AT_380, AT_760], lambertian(1.0))

    path = tmp_path / "a.journal"
    path.unlink(missing_ok=True)
    run = run_plan(plan_with(wavelengths="[760]", rig=rig_with(*changes)), path, set_spectrum)
    assert run.state is State.DONE
    with Journal.open(path) as journal:
        points = reduce_journal(journal).samples["gaussian-5"]
    assert points.good.sum() > 10
    return float(points.bsdf[points.good].mean())


def test_the_second_order_biases_the_bsdf_without_a_filter_and_not_with_one(tmp_path: Path) -> None:
    # The twin's lamp and photodiodes (twin/plant/model.py), between the points of their tables at 650 and 780 nm.
    lamp_760, diode_760 = 0.95 - 0.05 * 110.0 / 130.0, 0.38 + 0.10 * 110.0 / 130.0
    first, second = lamp_760 * diode_760, SHARE * 0.75 * 0.10
    biased = (first * AT_760 + second * AT_380) / (first + second)
    assert biased / AT_760 == pytest.approx(0.962, abs=1e-3)
    assert _bsdf_at_760(tmp_path) == pytest.approx(AT_760 / np.pi, rel=2e-3)
    assert _bsdf_at_760(tmp_path, second_order(SHARE)) == pytest.approx(biased / np.pi, rel=2e-3)
    assert _bsdf_at_760(tmp_path, second_order(SHARE), RIG_FILTERS, TWIN_FILTERS) == pytest.approx(AT_760 / np.pi, rel=2e-3)
    # A filter in the rig file does not help if the wheel has none.
    assert _bsdf_at_760(tmp_path, second_order(SHARE), RIG_FILTERS) == pytest.approx(biased / np.pi, rel=2e-3)
