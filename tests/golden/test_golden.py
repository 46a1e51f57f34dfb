"""What the program does is what it did: rows, plans, points and tables against the golden files (see `make.py`)."""

from pathlib import Path

import pytest

from tests.golden import contents, files, product
from tests.golden.compare import TABLE_3, check_lines, check_table, check_tables


@pytest.mark.parametrize("name", ["quick", "traced"])
def test_the_rows_and_points_of_a_campaign_are_the_golden_ones(name: str, tmp_path: Path) -> None:
    journal = contents.JOURNALS[name](tmp_path)
    found = contents.rows_record(product.measured_rows(journal)) | contents.points_record(journal)
    check_tables(found, files.read(name), name)


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=pytest.mark.long) for each in ("transmission-small", "everything", "transmission")]
)
def test_the_points_of_a_campaign_are_the_golden_ones(name: str, tmp_path: Path) -> None:
    check_tables(contents.points_record(contents.JOURNALS[name](tmp_path)), files.read(name), name)


SLOW_PLANS = ("anisotropic", "dense-lobe-spectral", "diffuse-spectral")


@pytest.mark.parametrize(
    "schedule", [pytest.param(each, marks=[pytest.mark.long] if each in SLOW_PLANS else []) for each in contents.PLANS]
)
def test_the_plans_of_a_schedule_are_the_golden_ones(schedule: str) -> None:
    check_tables(contents.plans_record(schedule), files.read(f"plans/{schedule}"), f"plans/{schedule}")


def test_every_schedule_of_the_examples_has_golden_plans() -> None:
    golden = {path.name for path in (files.DATA / "plans").iterdir()}
    assert {path.stem for path in contents.SCHEDULES.glob("*.toml")} == contents.PLANS.keys() == golden


@pytest.mark.parametrize("name", contents.SIMULATIONS)
def test_a_simulated_table_is_the_golden_one(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if not name.endswith(".csv"):  # the golden lines have no standard errors
        request.getfixturevalue("quick_errors")
    golden = files.read_lines(f"simulations/{name}")
    check_lines(contents.simulation_record(name, tmp_path), golden, name, simulated=True)


def test_the_noise_free_cells_of_table_3_are_the_golden_ones() -> None:
    check_table(contents.table_3_record()["noise-free"], files.read("table-3")["noise-free"], "table-3", TABLE_3)
