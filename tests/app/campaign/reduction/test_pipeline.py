"""The steps of the reduction: a contribution to the uncertainty is a function and a line, and is in everything that has u."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.reduction import pipeline
from goniotwin.app.campaign.reduction.arc_rows import ArcRows
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.drift_checks import compare_signals
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.rehearsal.forecast import forecast
from goniotwin.app.campaign.running.events import Event, RowCommitted, RowStarted
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.desktop.model.live_scan import LiveScan
from goniotwin.app.formats import read_points_csv
from goniotwin.app.rig import read_rig
from tests.app.campaign.campaign_bench import run_plan
from tests.app.campaign.reduction.grey_campaign import GLASS, reduced
from tests.app.data.exporting import export
from tests.conftest import RIG, SMALL, Change, Writer, changed

pytestmark = pytest.mark.xdist_group("pipeline")

PER_DECADE = 0.02
"""Relative uncertainty for each decade between the signals of sample and etalon; made up."""
SIGNALS = {
    "noise",
    "lamp",
    "dark",
    "resolution",
    "crosstalk",
    "etalon_reading",
    "monitor",
    "monitor_drift",
    "monitor_linearity",
    "gain",
    "linearity",
}
SLOPES = {"field", "field_noise", "field_unresolved", "second_order", "slope_unresolved"}
POSE = {"pose", "position", "photodiode_angle"}
SCALE = {"certificate", "etalon_age", "etalon_edge", "monochromator_stray"}
NAMES = {*SIGNALS, *SLOPES, *POSE, *SCALE}
Measured = tuple[Plan, Path, list[Event]]


def add_made_up(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """The whole contribution, apart from its line in the list of steps."""
    del settings
    decades = np.log10(np.maximum(np.abs(data.sample.value / data.etalon.value), 1e-12))
    return replace(data, estimate=data.estimate.with_own("made-up", (PER_DECADE * decades * data.estimate.value) ** 2))


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    """A run in one half plane: its plan, its journal and its events. Tests only read them."""
    plan = make_plan(parse_schedule(SMALL, "small.toml"), read_rig(RIG))
    path, events = tmp_path_factory.mktemp("pipeline") / "a.journal", list[Event]()
    run_plan(plan, path, listeners=[events.append])
    return plan, path, events


def live_u(plan: Plan, events: list[Event]) -> np.ndarray:
    """The uncertainties that the live plot shows after the last row."""
    live = LiveScan(plan)
    for event in events:
        if isinstance(event, RowStarted | RowCommitted):
            live.add_row(event)
    scan = live.data()
    assert scan is not None
    assert scan.complete
    return scan.points.u_values


def test_the_components_of_a_value_are_its_uncertainty(measured: Measured) -> None:
    points = reduced(measured[1]).samples["gaussian-5"]
    assert points.budget.keys() == NAMES
    total = np.sum([each**2 for each in points.budget.values()], axis=0)
    assert np.sqrt(total[points.good]) == pytest.approx(points.u_bsdf[points.good], rel=1e-12)
    certified = read_rig(RIG).file.etalon.relative_uncertainty
    assert points.budget["certificate"][points.good] == pytest.approx(certified * np.abs(points.bsdf[points.good]), rel=1e-12)


def test_a_contribution_of_one_function_and_one_line_is_in_everything_that_has_u(
    measured: Measured, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plan, path, events = measured
    before, live_before, spread_before = reduced(path).samples["gaussian-5"], live_u(plan, events), forecast(path).spread
    monkeypatch.setattr(pipeline, "ARC_STEPS", (*pipeline.ARC_STEPS, add_made_up))  # the line
    dataset = reduced(path)
    points = dataset.samples["gaussian-5"]
    assert points.bsdf.tobytes() == before.bsdf.tobytes()
    assert points.budget.keys() == NAMES | {"made-up"}
    good = points.good & (points.bsdf > 1e-9)
    decades = np.zeros(good.size)
    measured_bsdf = points.bsdf * np.exp(-points.field_correction)
    decades[good] = np.abs(np.log10(measured_bsdf[good] / (0.99 / np.pi)))  # over the BSDF of the rig file's etalon
    assert decades.max() > 2.0
    assert points.budget["made-up"][good] == pytest.approx((PER_DECADE * decades * points.bsdf)[good], rel=1e-9)
    expected = np.hypot(before.u_bsdf, points.budget["made-up"])
    assert points.u_bsdf[good] == pytest.approx(expected[good], rel=1e-6)
    assert (points.u_bsdf > 1.5 * before.u_bsdf)[good].any()

    export(dataset, None, tmp_path / "a.csv", "csv")
    assert read_points_csv(tmp_path / "a.csv").columns["u_bsdf_per_sr"] == pytest.approx(points.u_bsdf, rel=1e-8, nan_ok=True)
    assert forecast(path).spread["gaussian-5"].p50 > spread_before["gaussian-5"].p50

    order = np.argsort(-points.aspecular_deg, kind="stable")  # from the side of the light to that of the specular direction
    assert live_u(plan, events) == pytest.approx(points.u_bsdf[order], rel=1e-9, nan_ok=True)
    assert np.nanmax(live_u(plan, events) / live_before) > 1.5


ALMOST_TIES = "{ start = 0, stop = 0.28125, step = 0.0140625 }"
"""Steps of 360/25600 deg: the seventh decimal of every other angle is a 5."""


ANGLES, WAVELENGTH = (("[0, 1]", ALMOST_TIES), ("[30]", "[30.0140625]")), (("[550]", "[550.1234567]"),)


@pytest.mark.parametrize(
    ("changes", "light"),
    [
        pytest.param(ANGLES, "both", id="angles", marks=pytest.mark.long),
        pytest.param(WAVELENGTH, "both", id="wavelength", marks=pytest.mark.long),
        pytest.param(ANGLES, "reflected", id="angles, reflected"),
        pytest.param(WAVELENGTH, "reflected", id="wavelength, reflected"),
    ],
)
def test_rows_at_angles_and_wavelengths_between_two_roundings_have_all_values(
    tmp_path: Path, light: str, changes: tuple[Change, ...], write_rig: Writer
) -> None:
    """Etalon and sample meet by one rule of equal numbers, that of the journal and that of the live plot alike."""
    text = changed(SMALL, (*changes, ('samples = ["gaussian-5"]', f'samples = ["glass"]\nlight = "{light}"')))
    rig = read_rig(write_rig(("[twin.samples.etalon]", f"{GLASS}[twin.samples.etalon]")))
    plan = make_plan(parse_schedule(text, "small.toml"), rig)
    live = LiveScan(plan)

    def listen(event: Event) -> None:
        if isinstance(event, RowStarted | RowCommitted):
            live.add_row(event)

    run_plan(plan, tmp_path / "a.journal", listeners=[listen])
    found = reduced(tmp_path / "a.journal")
    points = found.samples["glass"]
    measured = [row.pose[3] for row in plan.rows if row.kind == "measure" and row.sample == "glass" and row.pose is not None]
    assert len(measured) in (2, 21)
    for transmitted in (False, True)[: 1 + (light == "both")]:
        assert sorted(np.unique(points.shift_deg[points.transmitted == transmitted])) == sorted(measured)
    assert not [note for note in found.notes if "etalon was not measured" in note]
    scan = live.data()
    assert scan is not None
    assert scan.points.values.size == points.bsdf.size


def test_what_two_signals_have_in_common_cancels_in_values_and_drift_checks() -> None:
    rig, u = read_rig(RIG).file, 0.003
    n = rig.photodiodes.count
    signal = Signal(np.full(n, 1.1), {"noise": np.full(n, 1e-12)}, gain=np.zeros(n, dtype=np.int64))

    def with_monitor(row: int) -> Signal:
        return signal.with_grouped("monitor", np.array([row]), -u * signal.value[:, None])

    assert compare_signals(with_monitor(1), with_monitor(2), rig, 0.005).u_change == pytest.approx(math.sqrt(2.0) * u, rel=1e-3)
    assert compare_signals(with_monitor(1), with_monitor(1), rig, 0.005).u_change < 1e-5
    assert (with_monitor(1) / with_monitor(2)).components["monitor"] == pytest.approx(np.full(n, 2.0 * u**2), rel=1e-12)
    assert np.all((with_monitor(1) / with_monitor(1)).components["monitor"] == 0.0)
