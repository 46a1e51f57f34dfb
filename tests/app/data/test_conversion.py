"""Conversion between formats: what goes along, what is chosen, what is omitted and named; and its commands."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import goniotwin
from goniotwin.app.cli.main import app
from goniotwin.app.data.conversion import Choice, Converted, convert_content, convert_file, format_to_write, parse_wavelength
from goniotwin.app.errors import GoniotwinError, UserError
from goniotwin.app.formats import registry, writing
from goniotwin.app.formats.content import BsdfFile, RegularTable, ScatteredBsdf, nodes
from goniotwin.app.formats.gridding import grid_table
from goniotwin.app.formats.metadata import Metadata, QualityMetadata, SampleMetadata, common_metadata
from goniotwin.app.formats.table import BsdfTable

SIGMA, PHI, THETA = np.array([0.0, 30.0, 60.0, 90.0]), np.arange(0.0, 181.0, 10.0), np.arange(0.0, 181.0, 2.0)


def table(**changes: Any) -> BsdfTable:
    """A lobe of 10 deg, of which the peak at normal incidence and all of the last sigma were not measured."""
    values = np.broadcast_to(np.exp(-((THETA / 10.0) ** 2)), (1, 1, SIGMA.size, PHI.size, THETA.size))
    known = np.ones(values.shape, dtype=bool)
    known[:, :, 0, :, THETA < 5.0] = known[:, :, -1] = False
    held = np.where(known | (SIGMA > 0.0)[:, None, None], values, np.exp(-0.36))
    given = BsdfTable(SIGMA, PHI, THETA, held, (550.0,), u=0.02 * held, known=known, sample="paint", comments=("a note",))
    return replace(given, **changes)


def convert(content: BsdfFile, path: Path, name: str | None = None, **choice: Any) -> Converted:
    return convert_content(content, path, format_to_write(path, name), Choice(**choice))


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """The JSON object that a command prints."""
    capsys.readouterr()
    assert not app([*map(str, arguments), "--json"], standalone_mode=False)
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def test_uncertainties_and_mask_go_from_file_to_file(tmp_path: Path) -> None:
    first = convert(BsdfFile((table(),)), tmp_path / "a.ddr")
    assert [each.name for each in first.files] == ["a.ddr", "a.u.ddr", "a.mask.ddr"]
    second = convert_file(tmp_path / "a.ddr", tmp_path / "b.bsdf", format_to_write(tmp_path / "b.bsdf"), Choice())
    assert [each.name for each in second.files] == ["b.bsdf", "b.u.bsdf", "b.mask.bsdf"]
    values, u, mask = (registry.read(each).only_table().values for each in second.files)
    np.testing.assert_allclose(values, table().values, rtol=1e-8)
    np.testing.assert_allclose(u, np.asarray(table().u), rtol=1e-8)
    np.testing.assert_array_equal(mask > 0.5, ~np.asarray(table().known))
    third = convert_file(tmp_path / "b.bsdf", tmp_path / "c.csv", format_to_write(tmp_path / "c.csv"), Choice())
    (points,) = registry.read(tmp_path / "c.csv").scattered
    expected = nodes(table())
    assert third.values == int(np.sum(np.asarray(table().known)))
    np.testing.assert_allclose(points.values, expected.values, rtol=1e-8)
    np.testing.assert_allclose(points.u, expected.u, rtol=1e-8)
    np.testing.assert_array_equal(points.flags, expected.flags)
    np.testing.assert_allclose(points.polar_deg, expected.polar_deg, atol=1e-6)
    back = convert_file(tmp_path / "c.csv", tmp_path / "d.ddr", format_to_write(tmp_path / "d.ddr"), Choice(fill="fit"))
    found = registry.read(tmp_path / "d.ddr").only_table()
    assert found.sigma_deg.tolist() == [0.0, 30.0, 60.0, 90.0]  # the last one repeated again
    assert found.values[0, 0, 0, 0, 0] == pytest.approx(1.0, rel=0.01)  # the peak, not the stump
    assert {round(share.sigma_deg) for share in back.shares} == {0, 30, 60}


def test_the_share_that_was_not_measured_is_reported_and_is_in_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    convert(BsdfFile((nodes(table()),)), tmp_path / "a.csv")
    result = run(capsys, "convert", tmp_path / "a.csv", tmp_path / "a.ddr")
    shares = {each["sigma_deg"]: each["share"] for each in result["not_measured"]}
    # Of a stump of exp(-0.36) up to 5 deg, in a lobe of 10 deg.
    hidden, rest = 0.5 * np.exp(-0.36) * 0.25, 0.5 * np.exp(-0.25)
    assert shares[0.0] == pytest.approx(hidden / (hidden + rest), rel=0.1)
    assert shares[30.0] < 0.001
    (line,) = (line for line in registry.read(tmp_path / "a.ddr").only_table().comments if "share of the light" in line)
    assert f"{100.0 * shares[0.0]:.3g} % at sigma 0" in line
    app(["convert", str(tmp_path / "a.csv"), str(tmp_path / "b.ddr"), "--fill", "neighbour"], standalone_mode=False)
    out = capsys.readouterr().out
    assert "at nodes of the table that were not measured, the most of 3 incidences. Gaps are filled by neighbour" in out
    with pytest.raises(UserError, match=r"c\.ddr: paint: at sigma 0 .* % of the light was not measured"):
        app(["convert", str(tmp_path / "a.csv"), str(tmp_path / "c.ddr"), "--fill", "refuse"], standalone_mode=False)
    assert not (tmp_path / "c.ddr").exists()


def test_a_sample_is_chosen_where_a_format_holds_one(tmp_path: Path) -> None:
    two = BsdfFile((table(), table(sample="glass", values=0.5 * table().values)))
    with pytest.raises(
        UserError, match=r"the format ddr has one sample, and there are: paint, glass; choose one with --sample"
    ):
        convert(two, tmp_path / "a.ddr")
    with pytest.raises(UserError, match="there is no sample 'wood'; there are: paint, glass"):
        convert(two, tmp_path / "a.ddr", sample="wood")
    convert(two, tmp_path / "a.ddr", sample="glass")
    np.testing.assert_allclose(registry.read(tmp_path / "a.ddr").only_table().values, 0.5 * table().values, rtol=1e-8)
    convert(two, tmp_path / "a.csv")
    assert registry.read(tmp_path / "a.csv").samples == ("paint", "glass")


def test_light_and_side_are_chosen_where_a_format_holds_one(tmp_path: Path) -> None:
    sides = [nodes(table(back=back, transmitted=through)) for back in (False, True) for through in (False, True)]
    mixed = [replace(each, values=np.full(each.size, 0.1 * (1 + k))) for k, each in enumerate(sides)]
    content = BsdfFile(tuple(mixed))
    with pytest.raises(UserError, match=r"there is reflected and transmitted light, .* zemax .*; choose it with --light"):
        convert(content, tmp_path / "a.bsdf")
    for light, side, value in (("transmitted", "front", 0.2), ("reflected", "back", 0.3), ("transmitted", "back", 0.4)):
        convert(content, tmp_path / "a.bsdf", light=light, side=side)
        found = registry.read(tmp_path / "a.bsdf").only_table()
        assert (found.transmitted, found.values.max()) == (light == "transmitted", pytest.approx(value))
    done = convert(content, tmp_path / "a.ddt")  # which holds transmitted light, of one side
    light = "the reflected light is omitted: the format ddt has no room for it"
    assert done.notes == ("the values of the back are omitted; --side back writes them", light)
    assert registry.read(tmp_path / "a.ddt").only_table().values.max() == pytest.approx(0.2)
    front = BsdfFile((mixed[0],))
    for choice, wrong in (({"light": "transmitted"}, "no transmitted light"), ({"side": "back"}, "with light on the back")):
        with pytest.raises(UserError, match=wrong):
            convert(front, tmp_path / "b.bsdf", **choice)


def test_a_regular_part_is_omitted_of_a_table_and_named(tmp_path: Path) -> None:
    regular = RegularTable(np.array([0.0, 60.0]), np.full((1, 1, 2), 0.04), (550.0,), sample="paint")
    done = convert(BsdfFile((table(), regular)), tmp_path / "a.ddr")
    assert done.notes == ("the regular part is omitted: the format ddr has no room for it; .sdr, .ssdd and .h5 have",)
    assert done.notes[0] in registry.read(tmp_path / "a.ddr").only_table().comments
    with pytest.raises(GoniotwinError, match=r"does not hold regular reflectance or transmittance"):
        convert(BsdfFile((regular,)), tmp_path / "b.csv")


def test_a_file_is_not_converted_to_itself_nor_to_one_beside_it(tmp_path: Path) -> None:
    convert(BsdfFile((table(),)), tmp_path / "a.ddr")
    before = (tmp_path / "a.u.ddr").read_bytes()
    for source, out in (("a.ddr", "a.ddr"), ("a.u.ddr", "a.ddr")):
        with pytest.raises(UserError, match="is the file itself; choose another name"):
            app(["convert", str(tmp_path / source), str(tmp_path / out)], standalone_mode=False)
    with pytest.raises(UserError, match=r"a\.u\.ddr: it has the uncertainties of a\.ddr, not values; give the table itself"):
        app(["convert", str(tmp_path / "a.u.ddr"), str(tmp_path / "b.ddr")], standalone_mode=False)
    assert (tmp_path / "a.u.ddr").read_bytes() == before


def test_a_folder_a_missing_file_and_an_unknown_format_are_one_line(tmp_path: Path) -> None:
    for source, out, wrong in (
        (tmp_path, "a.ddr", "is a folder without files that can be read"),
        (tmp_path / "no", "a.ddr", "there is no such file"),
        (tmp_path / "no", "a.xyz", r"the format is unknown; give a name that ends with \.ddr"),
        (tmp_path / "no", "sub/a.ddr", "there is no folder"),
    ):
        with pytest.raises(UserError, match=wrong):
            app(["convert", str(source), str(tmp_path / out)], standalone_mode=False)


def test_info_states_what_a_file_is_and_how_complete(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    convert(BsdfFile((table(generated=True),)), tmp_path / "a.ddr")
    found = run(capsys, "info", tmp_path / "a.ddr")
    assert (found["format"], found["simulated"], found["stands_for"]) == ("ddr", True, None)
    (part,) = found["parts"]
    known = np.asarray(table().known)
    assert (part["values"], part["measured"], part["with_uncertainty"]) == (known.size, np.count_nonzero(known), known.size)
    assert part["sigma_deg"] == SIGMA.tolist()
    assert part["not_measured"][0]["share"] > 0.1
    assert run(capsys, "info", tmp_path / "a.mask.ddr")["stands_for"] == "the mask of a.ddr"
    app(["info", str(tmp_path / "a.ddr")], standalone_mode=False)
    text = capsys.readouterr().out
    assert "SIMULATED, ddr, Lumicept table of a BRDF" in text
    assert "not measured: at most" in text


def test_info_counts_flags_and_lists_wavelengths(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sigma, psi, polar, azimuth = (np.full(4, value) for value in (30.0, 0.0, 40.0, 180.0))
    points = ScatteredBsdf(
        sigma,
        psi,
        polar,
        azimuth,
        np.array([1.0, np.nan, 2.0, 3.0]),
        wavelength_nm=np.array([450.0, 450.0, 550.0, 550.0]),
        flags=np.array(["", "dead", "drift steep", ""]),
        sample="paint",
    )
    convert(BsdfFile((points,)), tmp_path / "a.csv")
    (part,) = run(capsys, "info", tmp_path / "a.csv")["parts"]
    assert part["flags"] == {"dead": 1, "drift": 1, "steep": 1}
    assert (part["measured"], part["wavelengths_nm"]) == (2, [450.0, 550.0])


def test_of_an_archive_each_value_counts_once(tmp_path: Path) -> None:
    """It has a sample's values and the table made of them: all but a copy is made of the values."""
    grid = table()
    values = replace(nodes(grid), comments=())
    content = BsdfFile((values, grid))
    assert content.of_points().parts == (values,)
    through = replace(values, transmitted=np.ones(values.size, dtype=bool))
    assert len(BsdfFile((through, grid)).of_points().parts) == 2  # light of which there are no values
    path = tmp_path / "a.h5"
    writing.write(path, content, registry.format_named("archive", {registry.Holds.GRID}))
    assert goniotwin.open(path).size == values.size
    listed = convert_file(path, tmp_path / "a.csv", format_to_write(tmp_path / "a.csv"), Choice())
    assert registry.read(listed.files[0]).scattered[0].size == values.size
    made = convert_file(path, tmp_path / "a.ddr", format_to_write(tmp_path / "a.ddr"), Choice())
    np.testing.assert_allclose(registry.read(made.files[0]).only_table().values, grid_table(values).values, rtol=1e-8)


def spectral() -> BsdfTable:
    """Three wavelengths, 1 to 3 times the same values, at few directions."""
    values = np.array([1.0, 2.0, 3.0])[:, None, None, None, None] * np.ones((1, 1, 2, 2, 3))
    axes = (np.array([0.0, 90.0]), np.array([0.0, 180.0]), np.array([0.0, 90.0, 180.0]))
    return BsdfTable(*axes, values, (450.0, 550.0, 632.8), u=0.1 * values)


def test_one_wavelength_is_chosen_or_each_has_a_file(tmp_path: Path) -> None:
    regular = RegularTable(np.zeros(1), np.full((3, 1, 1), 0.04), (450.0, 550.0, 632.8))
    content, out = BsdfFile((spectral(), nodes(spectral()), regular)), tmp_path / "a.bsdf"
    with pytest.raises(
        UserError, match=r"the format zemax has one wavelength, and there are 450, 550, 632.8 nm; .* --wavelength all"
    ):
        convert(content, out)
    with pytest.raises(UserError, match=r"no wavelength 600 nm: there are 450, 550, 632.8 nm; the nearest are 550 and 632.8"):
        convert(content, out, wavelength_nm=600.0)
    with pytest.raises(UserError, match=r"its values have no wavelength; leave --wavelength out"):
        convert(BsdfFile((table(wavelengths_nm=None),)), out, wavelength_nm="all")
    assert not list(tmp_path.iterdir())
    convert(BsdfFile((spectral(),)), out, wavelength_nm=550.0)
    found = registry.read(out).only_table()
    assert (found.wavelengths_nm, found.values.max()) == ((550.0,), pytest.approx(2.0))
    done = convert(BsdfFile((spectral(),)), out, wavelength_nm="all")
    names = [f"a.{nm}nm.{u}bsdf" for nm in ("450", "550", "632.8") for u in ("", "u.")]
    assert [each.name for each in done.files] == names
    assert registry.read(done.files[5]).only_table().values.max() == pytest.approx(0.3)
    assert done.values == spectral().values.size
    whole = convert(content, tmp_path / "b.h5", wavelength_nm=632.8)
    assert [part.values.max() for part in registry.read(whole.files[0]).parts] == [3.0, 3.0, 0.04]
    with pytest.raises(UserError, match=r"a.550nm.bsdf: is the file itself"):
        convert_file(done.files[2], out, format_to_write(out), Choice(wavelength_nm="all"))


@pytest.mark.parametrize("text", ["blue", "", "450,550", "nan"])
def test_a_wavelength_is_a_number_or_all(text: str) -> None:
    assert [parse_wavelength(each) for each in (None, "all", "550", " 632.8 nm")] == [None, "all", 550.0, 632.8]
    with pytest.raises(UserError, match=r"^--wavelength '.*': give one wavelength in nm, such as 550, or all$"):
        parse_wavelength(text)


def test_of_a_journal_one_wavelength_has_every_column(
    journal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (whole, one, every) = (
        Path(run(capsys, "export", journal, "--out", tmp_path / name, *options)["file"])
        for name, options in (("a.csv", ()), ("b.csv", ("--wavelength", 550)), ("c.csv", ("--wavelength", "all")))
    )
    assert every.name == "c.550nm.csv"
    assert whole.read_bytes() == one.read_bytes() == every.read_bytes()
    with pytest.raises(UserError, match=r"d.csv: there is no wavelength 551 nm: there are 550 nm; the nearest is 550"):
        app(["export", str(journal), "--out", str(tmp_path / "d.csv"), "--wavelength", "551"], standalone_mode=False)


def test_each_sample_keeps_its_metadata(tmp_path: Path) -> None:
    about = {
        name: Metadata(operator="M. Lind", sample=SampleMetadata(identifier=name), quality=QualityMetadata(repeats=k))
        for k, name in enumerate(("paint", "glass"))
    }
    content = BsdfFile((table(), table(sample="glass")), common_metadata(about.values()), of_samples=about)
    assert content.metadata == Metadata(operator="M. Lind")
    convert(content, tmp_path / "a.h5")
    dataset = goniotwin.open(tmp_path / "a.h5")
    assert {name: dataset[name].metadata for name in dataset} == about
    convert_file(tmp_path / "a.h5", tmp_path / "b.ssdd", format_to_write(tmp_path / "b.ssdd"), Choice(sample="glass"))
    assert registry.read(tmp_path / "b.ssdd").metadata.sample.identifier == "glass"
    convert(content, tmp_path / "a.csv")
    lines = registry.read(tmp_path / "a.csv").comments
    assert {"operator: M. Lind", "paint: sample identifier: paint", "glass: sample identifier: glass"} <= set(lines)


def test_info_states_of_what_a_journal_is_and_how_complete(journal: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = run(capsys, "info", journal)
    assert found["samples"] == [{"sample": "gaussian-5", "rows": 3, "planned": 3}]
    assert (found["rows"], found["planned"], found["simulated"], found["damage"]) == (12, 12, True, "")
    assert (found["sigma_deg"], found["wavelengths_nm"], found["light"], found["side"]) == (
        [30],
        [550],
        ["reflected"],
        ["front"],
    )
    app(["info", str(journal)], standalone_mode=False)
    lines = capsys.readouterr().out.splitlines()
    assert lines[2] == "gaussian-5: reflected light on the front, stated as isotropic, 3 of 3 rows measured"
    assert {"  sigma: 30 deg", "  wavelengths: 550 nm"} <= set(lines)
    assert "linearly polarised" in lines[-1]


def test_a_result_has_not_the_name_of_a_file_beside_another(tmp_path: Path) -> None:
    for name, what in (("a.u.ddr", "uncertainties"), ("a.mask.ddr", "mask")):
        with pytest.raises(UserError, match=rf"{name}: the {what} of a.ddr would have this name; choose another one"):
            format_to_write(tmp_path / name)
    assert format_to_write(tmp_path / "a.u.csv").name == "csv"  # which has a column for it


@pytest.mark.parametrize(
    ("colours", "refusing", "holding"),
    [(("red", "green", "blue"), ".bsdf", ".ddr"), (("X", "Y", "Z"), ".ddr", ".bsdf"), (("L", "M", "S"), ".ddr", ".csv")],
)
def test_a_refusal_of_colours_names_formats_that_hold_them(
    colours: tuple[str, ...], refusing: str, holding: str, tmp_path: Path
) -> None:
    known = np.ones((3, 1, 2, 2, 3), dtype=bool)
    known[..., 2] = False
    content = BsdfFile((replace(spectral(), wavelengths_nm=None, colours=colours, known=known),))
    with pytest.raises(GoniotwinError) as caught:
        convert(content, tmp_path / f"a{refusing}")
    assert f"a{refusing}: the format " in str(caught.value)  # not the mask beside it
    named = re.findall(r"(\w+) \((\.\w+)", str(caught.value).partition("; use ")[2])
    assert holding in [suffix for _, suffix in named]
    for name, suffix in named:
        convert(content, tmp_path / f"b{suffix}", name)


def test_no_comment_repeats_what_the_metadata_state(journal: Path, tmp_path: Path) -> None:
    app(["export", str(journal), "--out", str(tmp_path / "a.ddr")], standalone_mode=False)
    texts = [line.removeprefix(";; ").rpartition(": ")[2] for line in (tmp_path / "a.ddr").read_text().splitlines()]
    for stated in ("the light at the sample", "no checksums", "virtual goniophotometer"):
        assert sum(text.startswith(stated) for text in texts) <= 1
    assert (tmp_path / "a.ddr").read_text().count(";; sample: gaussian-5") == 1


def test_a_grey_regular_part_is_of_every_wavelength_and_what_has_none_is_named(tmp_path: Path) -> None:
    grey = RegularTable(np.array([0.0, 60.0]), np.full((1, 1, 2), 0.04), sample="paint")
    convert(BsdfFile((table(), grey)), tmp_path / "a.ssdd", wavelength_nm=550.0)
    assert registry.read(tmp_path / "a.ssdd").regular[0].values.tolist() == [[[0.04, 0.04]]]
    other = replace(grey, wavelengths_nm=(600.0,))
    done = convert(BsdfFile((table(), other)), tmp_path / "b.ssdd", wavelength_nm=550.0)
    assert "a regular part is omitted: it has no values at 550 nm" in done.notes


def test_light_that_is_omitted_is_named(tmp_path: Path) -> None:
    done = convert(BsdfFile((table(), table(transmitted=True))), tmp_path / "a.ddr")
    assert done.notes == ("the transmitted light is omitted: the format ddr has no room for it",)
    assert done.notes[0] in registry.read(tmp_path / "a.ddr").only_table().comments


def test_the_rule_of_the_widest_gap_is_in_the_line_of_what_was_not_measured(tmp_path: Path) -> None:
    points = replace(nodes(table()), widest_gap_deg=3.0)
    line = convert(BsdfFile((points,)), tmp_path / "a.ddr").unmeasured_line
    assert line is not None
    assert "Between measured directions more than 3 deg apart the table is interpolated, and its u is" in line
    assert ".csv" in line


def test_negative_values_are_mentioned_once_with_their_quantity(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = table().values.copy()
    values[0, 0, 0, 0, :3] = (-0.25, -0.5, -0.125)
    convert(BsdfFile((replace(table(), values=values, known=None),)), tmp_path / "a.ddr")
    capsys.readouterr()
    result = run(capsys, "convert", tmp_path / "a.ddr", tmp_path / "b.ssdd")
    (line,) = (each for each in result["notes"] if "negative" in each)
    assert line == f"3 of {values.size} values of the BRDF are negative, the least -0.5 1/sr: they are written as they are"
    assert not any("negative" in line for line in registry.read(tmp_path / "b.ssdd").only_table().comments)
    known = np.ones(values.shape, dtype=bool)
    known[0, 0, 0, 0, :3] = False  # filled
    convert(BsdfFile((replace(table(), values=values, known=known),)), tmp_path / "a.h5")
    assert not any("negative" in each for each in run(capsys, "convert", tmp_path / "a.h5", tmp_path / "c.ssdd")["notes"])


@pytest.mark.parametrize(("peak", "said"), [(1.0, False), (40.0, True)])
def test_a_filled_table_that_scatters_more_than_it_receives_is_named(peak: float, said: bool, tmp_path: Path) -> None:
    whole = table()
    known = np.broadcast_to(whole.theta_deg < 20.0, whole.values.shape)
    notes = convert(BsdfFile((replace(whole, values=peak * whole.values, known=known),)), tmp_path / "a.ddr").notes
    assert any("times the light that it receives" in each for each in notes) is said
