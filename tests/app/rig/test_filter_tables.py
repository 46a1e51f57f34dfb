"""`[[monochromator.filters]]` and `[[twin.filters]]` of a rig file."""

import re

import pytest
import tomlkit

from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import parse_rig, read_rig
from goniotwin.app.rig.described_twin import described_twin
from goniotwin.app.rig.served_file import served_rig
from goniotwin.drivers import OrderFilter
from goniotwin.mocks.served import Endpoint, Wire
from goniotwin.twin.plant import OrderSorting, WheelFilter
from tests.app.campaign.filter_rig import FILTERS, RIG_FILTERS, TWIN_FILTERS, second_order
from tests.conftest import RIG, SMALL, Change, Writer, changed


def test_without_the_table_there_are_no_filters(write_rig: Writer) -> None:
    rig = read_rig(write_rig())
    assert rig.file.monochromator.wheel.filters == ()
    model = rig.model()
    assert model is not None
    assert model.order_sorting == OrderSorting()


def test_the_operators_filters_are_sorted_by_wavelength(write_rig: Writer) -> None:
    first, *others = FILTERS.strip().split("\n\n")
    upside_down = "\n\n".join([*others[::-1], first])
    for text in (FILTERS, upside_down):
        rig = read_rig(write_rig(("[photodiodes]\n", f"{text}\n[photodiodes]\n")))
        assert rig.file.monochromator.wheel.filters == (
            OrderFilter(1, "open", 380.0, 550.0),
            OrderFilter(4, "GG495", 550.0, 650.0, 495.0),
            OrderFilter(2, "RG610", 650.0, 780.0, 610.0),
        )
        model = rig.model()
        assert model is not None
        assert model.order_sorting == OrderSorting()  # the filters of the twin are another table


def test_the_twins_filters_are_its_own(write_rig: Writer) -> None:
    model = read_rig(write_rig(TWIN_FILTERS, second_order(0.1))).model()
    assert model is not None
    assert model.order_sorting == OrderSorting(0.1, (WheelFilter(4, 495.0), WheelFilter(2, 610.0)))
    assert model.order_sorting.filters[0].transmittance == 0.9


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("to_nm = 550\n", "to_nm = 540\n"), r"monochromator\.filters: there is no filter for 540 to 550 nm; widen a band"),
        (("from_nm = 380", "from_nm = 400"), r"monochromator\.filters: there is no filter for 380 to 400 nm; .* lowest_nm"),
        (("to_nm = 780", "to_nm = 700"), r"monochromator\.filters: there is no filter for 700 to 780 nm; .* highest_nm"),
        (("to_nm = 650", "to_nm = 651"), r"filters: the bands of 'GG495' \(550 to 651 nm\) and 'RG610' .* overlap; make"),
        (("position = 4", "position = 2"), r"monochromator\.filters: position 2 is given 2 times; keep one"),
        (("position = 4", "position = 7"), r"monochromator\.filters\.1\.position: .*less than or equal to 6, not 7"),
        (("position = 4", "position = 0"), r"monochromator\.filters\.1\.position: .*greater than or equal to 1, not 0"),
        (("to_nm = 650", "to_nm = 540"), r"monochromator\.filters\.1: from_nm 550 is not below to_nm 540; exchange them"),
        (("cut_on_nm = 610", "cut_on_nm = 660"), r"monochromator\.filters\.2: cut_on_nm 660 is above from_nm 650, so the"),
        (("cut_on_nm = 610", "cut_on = 610"), r"monochromator\.filters\.2\.cut_on: there is no such key.*'cut_on_nm'"),
        (('name = "GG495"\n', ""), r"monochromator\.filters\.1\.name: is missing; add it"),
        (('name = "GG495"', 'name = ""'), r"monochromator\.filters\.1\.name: .*at least 1 character"),
        (("from_nm = 550", "from_nm = nan"), r"monochromator\.filters\.1\.from_nm: .*finite"),
        (("from_nm = 380", "from_nm = -380"), r"monochromator\.filters\.0\.from_nm: .*greater than 0"),
        (("position = 4", 'position = "4"'), r"monochromator\.filters\.1\.position: .*integer"),
    ],
)
def test_an_impossible_filter_table_is_refused_in_one_line(write_rig: Writer, change: Change, message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        read_rig(write_rig(("[photodiodes]\n", f"{changed(FILTERS, (change,))}[photodiodes]\n")))
    assert "\n" not in str(caught.value)
    assert "rig.toml: " in str(caught.value)


def test_bands_may_extend_beyond_the_range_of_the_monochromator(write_rig: Writer) -> None:
    wider = changed(FILTERS, (("from_nm = 380", "from_nm = 200"), ("to_nm = 780", "to_nm = 1100")))
    rig = read_rig(write_rig(("[photodiodes]\n", f"{wider}[photodiodes]\n")))
    narrow = changed(FILTERS, (("to_nm = 780", "to_nm = 700"),))
    again = read_rig(
        write_rig(
            ("[photodiodes]\n", f"{narrow}[photodiodes]\n"),
            ('port = "twin://virtual/mono"\n', 'port = "twin://virtual/mono"\nhighest_nm = 700\n'),
        )
    )
    assert [len(each.file.monochromator.wheel.filters) for each in (rig, again)] == [3, 3]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("position = 2\ncut_on_nm = 500\n[[twin.filters]]\nposition = 2\ncut_on_nm = 600", r"filters: position 2 is given"),
        ("position = 5\ncut_on_nm = 500\n[twin.monochromator]\nfilters = 4", r"twin\.filters: a wheel of 4 positions has no"),
        ("position = 2\ncut_on_nm = 500\ntransmittance = 1.1", r"twin\.filters\.0\.transmittance: .*less than or equal to 1"),
        ("position = 2", r"twin\.filters\.0\.cut_on_nm: is missing"),
        ("position = 2\ncut_on_nm = 500\n[twin.monochromator]\nsecond_order = 1.0", r"second_order: .*less than 1"),
    ],
)
def test_an_impossible_filter_wheel_of_the_twin_is_refused(write_rig: Writer, text: str, message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        read_rig(write_rig(("[twin.light]\n", f"[[twin.filters]]\n{text}\n\n[twin.light]\n")))
    assert "\n" not in str(caught.value)


def test_the_model_hash_covers_the_twins_filters_and_is_unchanged_without(write_rig: Writer) -> None:
    """Journals from versions without filters can be resumed."""
    assert read_rig(RIG).model_hash() == read_rig(write_rig(RIG_FILTERS)).model_hash()
    cut = (TWIN_FILTERS, ("cut_on_nm = 610", "cut_on_nm = 600"))
    several = [(), (TWIN_FILTERS,), (second_order(0.1),), (TWIN_FILTERS, second_order(0.1)), cut]
    assert len({read_rig(write_rig(*changes)).model_hash() for changes in several}) == len(several)


def test_the_described_twin_has_the_filters_of_the_real_rigs_file() -> None:
    text = changed(RIG.read_text(encoding="utf-8"), (RIG_FILTERS, ("baudrate = 9600", "baudrate = 19200")))
    text = text.partition("# ---- what the virtual rig is")[0].replace("[simulated]\nseed = 1\n", "")
    for name in ("axes", "mono"):
        text = text.replace(f"twin://virtual/{name}", f"/dev/{name}")
    text = re.sub(r"twin://virtual/adc-(\d)", r"adam-\1:502", text).replace("twin://virtual/monitor", "1313:8078:P0012345")
    twin = described_twin(parse_rig(text, RIG.parent, "real"), "etalon", ["paper"], {})
    model = twin.rig.model()
    assert model is not None
    assert model.order_sorting == OrderSorting(0.0, (WheelFilter(4, 495.0), WheelFilter(2, 610.0)))
    assert [each.position for each in twin.rig.file.monochromator.wheel.filters] == [1, 4, 2]
    assert getattr(twin.rig.file.monochromator, "baudrate", None) == 9600
    assert any("filters with a cut_on_nm transmit 0.9 of the light" in each for each in twin.assumptions)


def test_a_served_rigs_file_keeps_the_operators_filters() -> None:
    rig = parse_rig(changed(RIG.read_text(encoding="utf-8"), (RIG_FILTERS, TWIN_FILTERS)), RIG.parent, "x")
    ends = [Endpoint(f"adc-{k}", "adam-6017", Wire.MODBUS_TCP, host="127.0.0.1", port=5020 + k) for k in range(5)]
    ends += [Endpoint(name, name, Wire.SERIAL, path=f"/dev/pts/{name}") for name in ("axes", "mono", "monitor")]
    text = served_rig(rig, ends, 1.0)
    served = parse_rig(text, RIG.parent, "served")
    assert served.file.monochromator.wheel == rig.file.monochromator.wheel
    assert served.model_hashes() == rig.model_hashes()
    assert len(served.model_hashes()) == 2
    assert "twin" not in tomlkit.parse(text)


def test_the_example_is_the_virtual_rig_with_filters_and_nothing_else() -> None:
    example, plain = (tomlkit.parse(path.read_text(encoding="utf-8")).unwrap() for path in (RIG.with_name("filters.toml"), RIG))
    assert [each["name"] for each in example["monochromator"].pop("filters")] == ["open", "GG495"]
    assert example["twin"].pop("filters")[0]["cut_on_nm"] == 495.0
    assert example["twin"].pop("monochromator") == {"second_order": 0.1}
    assert {**example, "name": plain["name"]} == plain
    schedule = parse_schedule(SMALL.replace("[550]", "{ start = 380, stop = 780, step = 10 }"), "x")
    result = check_plan(make_plan(schedule, read_rig(RIG.with_name("filters.toml"))))
    assert not [each for each in result.warnings if "half the wavelength" in each]
    assert result.filter_changes > 0
