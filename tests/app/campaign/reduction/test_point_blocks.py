"""A journal reduced in blocks: the values are bit-identical for any size of a block, and the memory is bounded."""

import gc
import tracemalloc
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.quantity import NONE
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.etalon import ReferenceSignals, join_references
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.rehearsal.forecast import forecast
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.studies.decades import UncertaintyByDecade
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.json_document import json_value
from goniotwin.app.rig import parse_rig, read_rig
from tests.conftest import RIG, SMALL, Writer, changed

pytestmark = pytest.mark.xdist_group("point blocks")

WHITE = ('model = "lambertian"\nreflectance = 0.99', 'model = "lambertian"\nreflectance = 0.99\nside = "both"')
GLASS = '[twin.samples.glass]\nmodel = "lambertian"\nreflectance = 0.4\ntransmittance = 0.3\nside = "both"\n\n'
FEW = (
    ('["gaussian-5"]', '["glass", "gaussian-5"]'),
    ("beta_deg = [180]", "beta_deg = [0, 45, 180]"),
    ("[0, 1]", "[0]"),
)
MANY = (*FEW[:2], ("[30]", "[30, 45]"), ("[550]", "[500, 550]"))
JOURNALS = pytest.mark.parametrize(
    ("journal", "sizes"),
    [
        pytest.param(FEW, (7, 10**9), id="few rows, two sizes", marks=pytest.mark.long),
        pytest.param(MANY, (1, 7, 40, 10**9), id="many rows", marks=pytest.mark.long),
    ],
    indirect=["journal"],
    scope="session",
)
EVERYTHING = (
    SMALL + 'side = "both"\nlight = "both"\nsignature = true\nrepeats = 2\n'
    "[drift]\nevery_s = 60\nsigma_deg = 30\nbeta_deg = 180\nwavelength_nm = 550\n"
    "[symmetry_check]\npoints = 2\n[overlap]\npoints = 2\ncalibrate = true\n"
)


@pytest.fixture(scope="session")
def journal(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two samples, lit on both sides, in both lights, with every table that the reduction evaluates. Tests only read it."""
    folder = tmp_path_factory.mktemp("blocks")
    sheets = (WHITE, ("[twin.samples.etalon]", f"{GLASS}[twin.samples.etalon]"))
    rig = parse_rig(changed(RIG.read_text(encoding="utf-8"), sheets), RIG.parent, "rig.toml")
    schedule = parse_schedule(changed(EVERYTHING, request.param), "schedule.toml")
    run_campaign(make_plan(schedule, rig), folder / "a.journal")
    return folder / "a.journal"


def plan_rows(journal: Journal, sample: str) -> list[Row]:
    return [row for row in journal.planned_rows() if row.sample == sample and row.kind == "measure"]


def bits(points: BsdfPoints) -> list[bytes]:
    columns = [each for name, each in points.columns().items() if name != "place" and " " not in name]
    arrays = (*columns, points.places[points.place], points.bsdf, points.u_bsdf, *points.components.values())
    return [np.where(np.isnan(each), np.nan, each).tobytes() for each in arrays]  # NaN has a sign, which means nothing


@pytest.mark.long
@JOURNALS
def test_values_are_the_same_for_any_size_of_a_block(journal: Path, sizes: tuple[int, ...]) -> None:
    with Journal.open(journal) as opened:
        whole = reduce_journal(opened)
    results: dict[str, list[list[bytes]]] = {"glass": [], "gaussian-5": []}
    for size in sizes:
        with Journal.open(journal, BlockSizes(block=size)) as opened:
            reduction = evaluate_journal(opened).reduction
            for sample, found in results.items():
                blocks, overlaps = list(reduction.blocks(sample)), reduction.overlaps(sample)
                points = BsdfPoints.join([reduction.finish(sample, block.points, overlaps) for block in blocks])
                found.append(bits(points))
                ranks = np.concatenate([block.rank for block in blocks])
                assert bits(points.where(np.argsort(ranks, kind="stable"))) == bits(whole.samples[sample])
                listed = [(row.wavelength_nm, row.pose[:2]) for row in plan_rows(opened, sample) if row.pose is not None]
                assert max(np.unique(block.rank).size for block in blocks) < size + max(Counter(listed).values())
    assert all(each == found[0] for found in results.values() for each in found)
    assert whole.samples["glass"].transmitted.any()
    assert whole.samples["glass"].back.any()


@pytest.mark.long
@JOURNALS
def test_a_forecast_is_the_same_for_any_size_of_a_block(journal: Path, sizes: tuple[int, ...], tmp_path: Path) -> None:
    forecasts = [forecast(journal, tmp_path / f"{size}.csv", ["of a test"], BlockSizes(block=size)) for size in sizes]
    assert all(each.spread == forecasts[0].spread for each in forecasts)
    assert all(json_value(each.check_results) == json_value(forecasts[0].check_results) for each in forecasts)
    assert len({(tmp_path / f"{size}.csv").read_bytes() for size in sizes}) == 1
    with Journal.open(journal) as opened:
        whole = reduce_journal(opened)
    for name, points in whole.samples.items():
        assert forecasts[0].spread[name].directions == points.bsdf.size
        at_once = UncertaintyByDecade()
        at_once.add(points)
        assert vars(forecasts[0].spread[name]).items() >= vars(at_once.summary()).items()
        assert forecasts[0].check_results.symmetry[name] == whole.symmetry[name]
        assert forecasts[0].check_results.overlaps[name] == whole.overlaps[name]
    assert whole.symmetry["glass"].pairs > 0
    assert whole.overlaps["glass"].pairs > 0


@pytest.mark.long
@pytest.mark.parametrize("steps", [(20.0, 5.0), (4.0, 1.0)], ids=["few", "many"])
def test_the_memory_of_a_forecast_grows_by_much_less_than_a_kilobyte_per_row(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, steps: tuple[float, float]
) -> None:
    small = BlockSizes(16, 16, 16, 16, 16, 16)  # with small blocks a short journal shows what a long one takes
    rig, memory, rows = read_rig(write_rig()), [], []
    for step in steps:
        many = ("[550]", f"{{ start = 500.0, stop = 600.0, step = {step} }}")
        plan, _ = plan_rehearsal(
            read_schedule(write_schedule(many, ("[1e8, 1e10]", "[1e8]"), ("[180]", "[0, 90, 180]"))), rig, {}
        )
        path = tmp_path / f"{step}.journal"
        rehearse(plan, out=path)
        forecast(path, tmp_path / "a.csv", sizes=small)  # imports what it needs, and fills what is kept of poses
        gc.collect()
        tracemalloc.start()
        forecast(path, tmp_path / "a.csv", sizes=small)
        memory.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        rows.append(len(plan.rows))
    # All points at once, as text, would take 20 kB per row.
    assert (memory[1] - memory[0]) / (rows[1] - rows[0]) < 600.0


@JOURNALS
def test_each_sample_has_factors_of_its_own_from_its_overlaps(journal: Path, sizes: tuple[int, ...]) -> None:
    """Values of two samples by one photodiode do not share them."""
    del sizes
    with Journal.open(journal) as opened:
        reduction, whole = evaluate_journal(opened).reduction, reduce_journal(opened)
        effects = [effects_of(whole.samples[name], reduction.settings) for name in ("glass", "gaussian-5")]
    inputs = []
    for each in effects:
        (group,) = [group for group in each.groups if group.name == "calibration"]
        inputs.append({each.name for each in group.inputs.values()})
    assert inputs[0]
    assert inputs[1]
    assert {name.partition("@")[2] for name in inputs[0]} == {"sample 1"}
    assert {name.partition("@")[2] for name in inputs[1]} == {"sample 2"}


@JOURNALS
def test_a_signature_that_was_measured_in_part_has_no_input_elsewhere(journal: Path, sizes: tuple[int, ...]) -> None:
    del sizes
    with Journal.open(journal) as opened:
        reduction = evaluate_journal(opened).reduction
        numbers = reduction.measurements.row_table("gaussian-5")["number"][:4].tolist()
        rows = reduction.measurements.rows_in_columns(numbers)
        assert rows is not None
        references = [each.at_places(rows.places) for each in (reduction.etalon, reduction.signature)]
        first = reduction.signature.at_places(rows.places[:1])
    assert None not in references
    assert first is not None
    for _, arc in join_references(rows, ReferenceSignals(references[0], first), reduction.settings):
        measured = arc.signature_measured[:, 0]
        assert measured.any()
        assert not measured.all()
        for name, terms in arc.signature.grouped.items():
            assert np.all(terms.member[~measured] == NONE), name
            assert np.any(terms.member[measured] != NONE), name
