"""`[photodiodes]` and `[twin.photodiodes]`: numbers and places that do not fit are one line, never an internal error."""

import re
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import open_rig, parse_rig, read_rig
from goniotwin.protocols.clock import VirtualClock
from tests.app.campaign.campaign_bench import run_plan
from tests.conftest import RIG, SMALL

BY_LIGHT = SMALL.replace("[1e8, 1e10]", '"automatic"') + "\n[averaging]\nrelative_uncertainty = 0.005\nlongest_s = 2.0\n"
"""Gains and readings depend on the light, so that a plan asks the twin for it."""


def rig_text(believed: dict[str, Any], own: dict[str, Any] | None) -> str:
    document: dict[str, Any] = tomlkit.parse(RIG.read_text(encoding="utf-8"))
    document["photodiodes"].update(believed)
    if own is not None:
        document["twin"]["photodiodes"] = own
    return tomlkit.dumps(document)


def angles(upper: int, lower: int) -> dict[str, Any]:
    places = {"upper_deg": [k * 85.0 / 40.0 for k in range(upper)], "lower_deg": [k * 85.0 / 40.0 for k in range(lower)]}
    return {**places, "units": [f"twin://virtual/adc-{k}" for k in range(-(-(upper + lower) // 8))]}


def own(upper: int, lower: int) -> dict[str, Any]:
    return {key: value for key, value in angles(upper, lower).items() if key != "units"}


@pytest.mark.parametrize(("believed", "twin"), [((40, 40), None), ((18, 18), (9, 9)), ((9, 0), (4, 0)), ((18, 18), (1, 0))])
def test_more_converters_than_the_virtual_rig_has_are_one_line_that_names_both_tables(
    believed: tuple[int, int], twin: tuple[int, int] | None
) -> None:
    with pytest.raises(UserError) as refused:
        parse_rig(rig_text(angles(*believed), own(*twin) if twin else None), RIG.parent, "rig.toml")
    upper, lower = twin or (18, 18)
    pattern = (
        rf"rig\.toml: photodiodes\.units\.\d+: the virtual rig has no converter adc-\d+: \[photodiodes\] has {sum(believed)} "
        rf"angles, \[twin\.photodiodes\] {upper + lower} .*; give both tables the photodiodes of the rig, or correct units"
    )
    assert re.fullmatch(pattern, str(refused.value))


@pytest.mark.parametrize(("believed", "twin"), [((18, 0), None), ((4, 4), None), ((18, 18), (18, 17)), ((8, 0), (9, 0))])
def test_a_channel_without_a_photodiode_is_dark_in_the_plan_as_on_the_wire(
    believed: tuple[int, int], twin: tuple[int, int] | None, tmp_path: Path
) -> None:
    rig = parse_rig(rig_text(angles(*believed), own(*twin) if twin else None), RIG.parent, "rig.toml")
    plan = make_plan(parse_schedule(BY_LIGHT, "by light"), rig)
    run = run_plan(plan, tmp_path / "a.journal")
    assert run.state is State.DONE
    assert all(reading.counts.shape[1] == sum(believed) for row in run.rows for reading in row.data.readings)


ANY_ANGLE = st.one_of(
    st.floats(0.0, 90.0), st.floats(), st.integers(-400, 400), st.sampled_from([0, 90, 90.0000001, -0.0, 1e308, "5", True])
)
LIKELY_ANGLES = st.integers(0, 45).map(lambda n: [85.0 * k / 45 for k in range(n)])
ANGLES = st.one_of(LIKELY_ANGLES, LIKELY_ANGLES, st.lists(ANY_ANGLE, max_size=20))
UNITS = st.one_of(
    st.integers(0, 7).map(lambda n: [f"twin://virtual/adc-{k}" for k in range(n)]),
    st.lists(
        st.sampled_from(
            [
                "twin://virtual/adc-0",
                "twin://virtual/adc-1",
                "twin://virtual/adc-77",
                "twin://virtual/mono",
                "twin://other/adc-0",
                "twin://virtual",
                "adam-0:502",
                "rtu:twin://virtual/adcs?unit=1",
                "",
            ]
        ),
        max_size=6,
    ),
)
KINDS = st.sampled_from(["adam-6017", "adam-4117"])


@st.composite
def tables(draw: st.DrawFn) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Both tables; the units are often as many as the photodiodes need."""
    believed: dict[str, Any] = {"upper_deg": draw(ANGLES), "lower_deg": draw(ANGLES), "kind": draw(KINDS)}
    needed = -(-(len(believed["upper_deg"]) + len(believed["lower_deg"])) // 8)
    likely = st.sampled_from(["twin://virtual/adc-{}", "adam-{}:502", "127.0.0.1:5{}", "rtu:/dev/ttyUSB1?unit={}"])
    written = draw(st.none() | likely)
    believed["units"] = draw(UNITS) if written is None else [written.format(k) for k in range(needed)]
    if believed["kind"] == "adam-4117":
        believed["gains_v_per_a"] = [1e11]
    return believed, draw(st.none() | st.fixed_dictionaries({"upper_deg": ANGLES, "lower_deg": ANGLES}))


@given(tables())
def test_any_number_and_place_of_photodiodes_is_a_rig_that_opens_or_one_line(
    tmp_path_factory: pytest.TempPathFactory, found: tuple[dict[str, Any], dict[str, Any] | None]
) -> None:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(rig_text(*found), encoding="utf-8")
    refused = ""
    try:
        rig = read_rig(path)
        with open_rig(rig, VirtualClock()) as opened:
            opened.connect()
        make_plan(parse_schedule(BY_LIGHT, "by light"), rig)
    except UserError as error:
        refused = str(error)
    assert "\n" not in refused
