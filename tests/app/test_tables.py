"""Error messages about rig files and schedules: one line with file, key and reason."""

import os
from pathlib import Path

import pytest

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import ScheduleFile, read_schedule
from goniotwin.app.campaign.schedule.grids import GridRange, grid_values
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.toml_file import parse_toml
from tests.conftest import RIG, SCHEDULE, Change, Writer


def test_the_example_files_give_a_plan() -> None:
    plan = make_plan(read_schedule(SCHEDULE), read_rig(RIG))
    assert len(plan.rows) == len({row.identity for row in plan.rows}) == 130
    assert [row.number for row in plan.rows] == list(range(130))


BAD_RIGS = [
    (("gear = 36.0", "gaer = 36.0"), r"axes\.sigma\.gaer: there is no such key; did you mean 'gear'\?"),
    (("gear = 36.0\n", "\n"), r"axes\.sigma\.gear: is missing"),
    (("gear = 36.0", "gear = -1"), r"axes\.sigma\.gear: .*greater than 0"),
    (("gear = 36.0", 'gear = "big"'), r"axes\.sigma\.gear: .*number"),
    (("gear = 36.0", "gear = nan"), r"axes\.sigma\.gear: .*finite"),
    (("motor = 0", "motor = 3"), r"axes: gamma and shift are both motor 3"),
    (("upper_deg = 180.0", "upper_deg = -180.0"), r"axes\.sigma: lower_deg 0 is not below upper_deg -180"),
    (("[simulated]\nseed = 1\n", ""), r"or add a \[simulated\] table"),
    (('kind = "tmcl"', 'kind = "tmlc"'), r"axes\.kind: .*'tmcl'"),
    (('"twin://virtual/adc-4"', '"twin://other/adc-4"'), r"several virtual rigs: other, virtual"),
    ((', "twin://virtual/adc-4"', ""), r"photodiodes: 36 photodiodes need 5 units of 8 channels, not 4"),
    (('model = "gaussian"', 'model = "gauss"'), r"twin\.samples\.gaussian-5: .*gaussian"),
    (("width_deg = 5.0", "width_deg = -5.0"), r"twin\.samples\.gaussian-5: width_deg is -5"),
    (('form = "one_over_e"', 'form = "fwhm"'), r"twin\.samples\.gaussian-5\.form: "),
    (("[axes]", "[axes"), r"is not TOML: .*line"),
    (("[1e6, 1e8, 1e10, 1e11]", "[1e6, 1e8, 1e8, 1e10]"), r"photodiodes\.gains_v_per_a: the gains do not ascend"),
    (("shift = { motor = 0", "shift = { motor = 3"), r"twin\.axes: motor 3 turns 2 axes"),
    (("arc_radius_mm = 300.0", "arc_radius_mm = 300.0\nfield_deg = 200.0"), r"geometry\.field_deg: .*less than 180"),
    (("[twin.light]", "[twin.optics]\nfield_deg = 200.0\n\n[twin.light]"), r"twin\.optics\.field_deg: .*less than 180"),
    (("[axes.gamma]", "[axes.gamma]\nencoder = 1"), r"axes\.gamma\.encoder: .*boolean, not 1"),
    (('name = "virtual goniophotometer"', "name = 2030-01-01"), r"name: .*string, not the date 2030-01-01"),
    (("[etalon]", '[etalon]\ncalibrated = "2030-01-01"'), r"etalon\.calibrated: .*not text: 2030-01-01 without the quotes"),
    (
        ('name = "virtual goniophotometer"', 'name = "a"\nlight = 2030-01-01'),
        r"light: should be a table, not the date 2030-01-01",
    ),
    (("[etalon]", "[etalon]\ncalibrated = 2030-01-01T08:00:00"), r"calibrated: .*date without a time, not 2030-01-01T08"),
    (("[twin.light]", "[twin.optics]\nrays = 17\n\n[twin.light]"), r"twin\.optics\.rays: .*multiple of 4"),
]


@pytest.mark.parametrize(("change", "message"), BAD_RIGS)
def test_an_invalid_rig_file_is_refused_in_one_line_with_the_key(write_rig: Writer, change: Change, message: str) -> None:
    path = write_rig(change)
    with pytest.raises(UserError, match=message) as caught:
        read_rig(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


BAD_SCHEDULES = [
    (("sigma_deg", "sigma_dge"), r"sigma_dge: there is no such key; did you mean 'sigma_deg'\?"),
    (("sigma_deg = [30]", "sigma_deg = [90]"), r"sigma_deg: 90 deg is not from 0 to 87"),
    (("sigma_deg = [30]", "sigma_deg = [30, 30]"), r"sigma_deg: 30.* is listed twice"),
    (("shift_deg = [0, 1]", "shift_deg = { start = 0, stop = 1, step = 0.3 }"), r"shift_deg.*not a whole number of steps"),
    (("shift_deg = [0, 1]", "shift_deg = { start = 1, stop = 0, step = 0.5 }"), r"shift_deg.*below start"),
    (("shift_deg = [0, 1]", "shift_deg = { start = 0, stop = 1, step = 1e-9 }"), r"shift_deg.*more than 100000"),
    (("shift_deg = [0, 1]", "shift_deg = []"), r"shift_deg.*at least 1"),
    (("readings = 2\n", "readings = 0\n"), r"readings: .*greater than or equal to 1"),
    (("readings = 2\n", "readings = true\n"), r"readings: .*integer"),
    (("readings = 2\n", 'readings = "2"\n'), r"readings: .*integer"),
    (("readings = 2\n", "readings = 1000000000\n"), r"readings: .*10000"),
    (("dark_readings = 4", "dark_readings = 2"), r"dark_readings: .*greater than or equal to 4"),
    (("wavelength_nm = [550]", "wavelength_nm = [550, 550.0000001]"), r"wavelength_nm: 550.* is listed twice"),
    (('name = "small"', 'name = "sm\\nall"'), r"name: "),
    (('etalon = "etalon"', 'etalon = "gaussian-5"'), r"etalon 'gaussian-5' is among the samples"),
    (('["gaussian-5"]', '["nothing"]'), r"'nothing' is the name of the empty sample unit"),
    (("shift_deg = [0, 1]", "shift_deg = [0, { start = 0, stop = 1, step = 0.3 }]"), r"shift_deg\.1: .*not a whole number"),
    (("shift_deg = [0, 1]", 'shift_deg = [0, "a"]'), r"shift_deg\.1: .*number"),
    (("shift_deg = [0, 1]", 'shift_deg = "all"'), r"shift_deg: .*list"),
    (("shift_deg = [0, 1]", "shift_deg = [[0]]"), r"shift_deg\.0: should be a range or a number, not a list"),
    (("[1e8, 1e10]", '"auto"'), r"gains_v_per_a: should be 'automatic' or a list of gains, not 'auto'"),
    (
        ("dark_readings = 4", 'dark_readings = 4\n[certificate]\nfile = "c.csv"\nexpires = "2030-01-01"'),
        r"certificate\.expires: should be a date, not text: 2030-01-01 without the quotes",
    ),
    (('name = "small"', 'name = "small"\nside = "left"'), r"side: .*'front', 'back' or 'both'"),
    (('name = "small"', 'name = "small"\nlight = "scattered"'), r"light: .*'reflected', 'transmitted' or 'both'"),
    (('name = "small"', 'name = "small"\norder = ["shift", "beta"]'), r"order: must list each of gamma, sigma, beta, shift"),
    (('name = "small"', 'name = "small"\norder = "slowest"'), r"order: should be 'fastest' or a list of all five loops"),
    (('name = "small"', 'name = "small"\nrepeats = 0'), r"repeats: .*greater than or equal to 1"),
    (("dark_readings = 4", "dark_readings = 4\n[near_specular]\nwithin_deg = 5"), r"near_specular: has neither"),
    (("dark_readings = 4", "dark_readings = 4\n[near_specular]\nshift_deg = [1]"), r"near_specular\.within_deg: is missing"),
    (
        ("dark_readings = 4", 'dark_readings = 4\nsymmetry = "anisotropic"\n[symmetry_check]\npoints = 3'),
        r"symmetry_check: an anisotropic sample has no symmetry to check",
    ),
    (("dark_readings = 4", "dark_readings = 4\n[overlap]\npoints = 0"), r"overlap\.points: .*greater than 0"),
    *(
        (("dark_readings = 4", f"dark_readings = 4\n[second_standard]\n{keys}"), rf"second_standard.*: {reason}")
        for keys, reason in (
            ("turned = true", "is missing"),
            ('name = "b"', "radiance_factor is missing: give"),
            ('name = "b"\nradiance_factor = 0.99', "relative_uncertainty is missing: give"),
            ('name = "b"\nradiance_factor = 99.0\nrelative_uncertainty = 0.01', "a radiance factor of 99 is above"),
            ('name = "b"\nturned = true\nradiance_factor = 0.99', "a turned etalon has the etalon's certificate"),
            ('name = "etalon"\nturned = true', "'etalon' is the etalon or a sample already"),
            ('name = "gaussian-5"\nturned = true', "'gaussian-5' is the etalon or a sample already"),
            ('name = "b"\ntable = "radiance_factor"', "line 1: relative_uncertainty is missing"),
            ('name = "b"\nshape = 0.01\ntable = "radiance_factor,relative_uncertainty"', "the table has the certificate"),
        )
    ),
]


@pytest.mark.parametrize(("change", "message"), BAD_SCHEDULES)
def test_an_invalid_schedule_is_refused_in_one_line_with_the_key(write_schedule: Writer, change: Change, message: str) -> None:
    path = write_schedule(change)
    with pytest.raises(UserError, match=message) as caught:
        read_schedule(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_byte_order_mark_at_the_beginning_of_a_file_is_accepted(write_schedule: Writer) -> None:
    path = write_schedule(("dark_readings = 4", 'dark_readings = 4\n[certificate]\nfile = "c.csv"\nexpires = 2999-01-01'))
    table = "radiance_factor,relative_uncertainty\n0.98,0.002\n"
    (path.parent / "c.csv").write_text(table, encoding="utf-8-sig")
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-8-sig")
    schedule = read_schedule(path)
    assert schedule.file.name == "small"
    assert schedule.certificate == table


IMPOSSIBLE_ON_THE_RIG = [
    (("shift_deg = [0, 1]", "shift_deg = [0, 7]"), r"shift_deg: 7 deg is outside its soft limits -0.5 to 5.5 deg"),
    (("beta_deg = [180]", "beta_deg = [400]"), r"beta_deg: 400 deg is outside"),
    (("wavelength_nm = [550]", "wavelength_nm = [900]"), r"wavelength_nm: 900 nm is outside"),
    (("1e10]", "1e9]"), r"gains_v_per_a: 1e\+09 is not a gain of"),
    (('samples = ["gaussian-5"]', 'samples = ["satin"]'), r"no sample 'satin'"),
    (
        ("beta_deg = [180]", "beta_deg = { start = 0, stop = 180, step = 0.005 }"),
        None,
    ),
]


@pytest.mark.parametrize(("change", "message"), IMPOSSIBLE_ON_THE_RIG)
def test_a_schedule_that_the_rig_cannot_run_is_refused_before_the_start(
    write_schedule: Writer, change: Change, message: str | None
) -> None:
    schedule = read_schedule(write_schedule(change))
    if message is None:
        assert len(make_plan(schedule, read_rig(RIG)).rows) > 100_000
        return
    with pytest.raises(UserError, match=message):
        make_plan(schedule, read_rig(RIG))


def test_ten_million_rows_are_refused_with_the_arithmetic(write_schedule: Writer) -> None:
    path = write_schedule(
        ("beta_deg = [180]", "beta_deg = { start = 0, stop = 180, step = 0.01 }"),
        ("sigma_deg = [30]", "sigma_deg = { start = 0, stop = 80, step = 0.25 }"),
    )
    with pytest.raises(UserError, match=r"2 samples and etalon x 321 sigma_deg x 18001 beta_deg x 2 shift_deg = 23113284 rows"):
        make_plan(read_schedule(path), read_rig(RIG))


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"", b"name = 'x'"])
def test_any_other_file_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.toml"
    path.write_bytes(content)
    for read in (read_rig, read_schedule):
        with pytest.raises(UserError) as caught:
            read(path)
        assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"absent\.toml: cannot be read"):
        read_schedule(tmp_path / "absent.toml")


def test_a_range_includes_its_stop() -> None:
    values = grid_values(GridRange(start=0.0, stop=4.5, step=0.1))
    assert len(values) == 46
    assert values[-1] == 4.5
    assert values[3] == 0.3


def test_a_grid_is_a_list_or_a_range() -> None:
    file = ScheduleFile.model_validate(
        {
            "name": "n",
            "samples": ["a"],
            "etalon": "e",
            "sigma_deg": [1, 2],
            "beta_deg": {"start": 0, "stop": 1, "step": 1},
            "wavelength_nm": [550],
            "gains_v_per_a": [1e8],
        }
    )
    assert grid_values(file.sigma_deg) == (1.0, 2.0)
    assert grid_values(file.beta_deg) == (0.0, 1.0)


def test_a_grid_may_mix_numbers_and_adjacent_ranges() -> None:
    fine, coarse = GridRange(start=0.0, stop=2.0, step=1.0), GridRange(start=2.0, stop=10.0, step=4.0)
    assert grid_values([fine, coarse, 8.0]) == (0.0, 1.0, 2.0, 6.0, 10.0, 8.0)


EXTREMES = [
    ("dotted keys", "a" + ".a" * 50_000 + " = 1", r"more than 10 levels .*line 1"),
    ("a dotted heading", "[" + "a." * 50_000 + "a]", r"more than 10 levels .*line 1"),
    ("nested lists", "\na = " + "[" * 5000 + "]" * 5000, r"more than 10 levels .*line 2"),
    ("nested tables", "a = " + "{a = " * 5000 + "1" + "}" * 5000, r"more than 10 levels"),
    ("after a text with quotes at its end", '\na = """b"""""\nc = ' + "[" * 5000, r"more than 10 levels .*line 3"),
    ("after a text without an end", 'a = """' + '\\"""\n' * 100_000, r"is not TOML"),
    ("digits", "a = " + "9" * 4301, r"a word of 4301 characters .*line 1"),
    ("length", "#" * 1_000_001, r"more than 1000000 characters"),
    ("an impossible date", "a = 2026-02-31", r"is not TOML"),
]


@pytest.mark.parametrize(
    ("text", "reason"), [(text, reason) for _, text, reason in EXTREMES], ids=[name for name, *_ in EXTREMES]
)
def test_a_text_that_exhausts_a_parser_is_refused_before_it_is_parsed(text: str, reason: str) -> None:
    with pytest.raises(UserError, match=f"^x.toml: .*{reason}"):
        parse_toml(text, "x.toml")


def test_what_stands_in_texts_and_comments_is_no_level() -> None:
    marks = "[{." * 20
    content = parse_toml(f"""# {marks}\na = "\\"{marks}"\nb = '{marks}'\nc = '''\n{marks}'''\n""", "x.toml")
    assert content == {"a": f'"{marks}', "b": marks, "c": marks}


@pytest.mark.parametrize("value", ["1e-300", "-1e300", "1e25"])
def test_a_number_of_impossible_magnitude_is_refused(value: str, write_rig: Writer) -> None:
    with pytest.raises(UserError, match=rf"axes\.sigma\.gear: {value.replace('e', 'e.?')} is not from 1e-24 to 1e\+24"):
        read_rig(write_rig(("gear = 36.0\nlower", f"gear = {value}\nlower")))


def test_ranges_are_counted_before_they_are_built(write_schedule: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(GridRange, "values")
    ranges = ", ".join(["{ start = 0, stop = 100000, step = 1 }"] * 1000)
    with pytest.raises(UserError, match=r"wavelength_nm: has 100001000 values, more than 100000"):
        read_schedule(write_schedule(("wavelength_nm = [550]", f"wavelength_nm = [{ranges}]")))


def test_a_campaign_of_more_than_a_year_is_refused(write_rig: Writer) -> None:
    slow = write_rig(("speed_deg_s = 10.0", "speed_deg_s = 1e-6"))
    with pytest.raises(UserError, match=r"would take .* days, more than a year; correct .*rig\.toml"):
        make_plan(read_schedule(SCHEDULE), read_rig(slow))


def test_a_device_or_a_folder_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (Path("/dev/zero"), tmp_path, tmp_path / "pipe"):
        with pytest.raises(UserError, match="is a folder or a device, not a file"):
            read_rig(path)


def test_a_message_is_one_line_of_a_readable_length() -> None:
    text = str(UserError("a\nb\x1b[31m" + "x" * 1_000_000))
    assert text.startswith("a b?[31mxx")
    assert len(text) < 2100
