"""Files of other instruments: FRED, VIAVI, pab, REFLET with its Speos export, reflectance factors.

Small files as they are laid out; the real ones are read in test_real_bsdf.py.
"""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from goniotwin.app.formats import eds, fred, pab, reflectance_factors, reflet, speos_rtd
from goniotwin.app.formats.content import ScatteredBsdf

from .scattered import only_list, refusal, rows, scattered

# The layout of data/processed/fred/AnoBlackEC1onAlum.txt (ua-loft/bsdf-tools).
FRED = """\
type bsdf_data
format angles=deg bsdf=value scale=1
10\t0
0\t0\t0.031984
10\t0\t0.0348
10\t140\t-1e-6
30\t0
0\t0\t0.020408
30\t0\t0.042017
"""
# The layout of VIAVI's files; the diffuser sends light that comes in at 10 deg on to azimuth 345.
EDS = """\
!!EDS10 10-345  RPC Photonics 10/29/2014
!!BSDF Data
10 345
0 0 2.0
0 1 2.0
10 344 20.0
10 345 21.0
30 165 0.5
"""
PAB = """\
#sample_name "blind"
#format: theta phi BSDF
#incident_angle 30 10
#upphi 90
15 190 0.25
150 10 0.5
"""
FACTORS = """\
BRF Values
a panel, (2 inch)
src_z\tsrc_a\tview_z\tview_a\t385.65nm\t1.064um
  0.000\t  0.000\t 45.000\t180.000\t1.0\t1.02
 45.000\t 10.000\t  0.000\t  0.000\t0.5\tNaN
  0.000\t  0.000\t 45.000\t180.000\t0.99\t1.01
"""
REFLET = """\
Name / Comment :\tpaint 7\t
Data file type :\tIntensity BRDF\t
Theta sample :\t0\t
Spectral Mode :\t0\t
Theta measure beginning :\t-30\t
Theta measure end :\t30\t
Theta measure step :\t30\t
'Scanning :\t2 axes\t
Phi measure beginning :\t-90\t
Phi measure end :\t-80\t
Phi measure step :\t10\t
Theta Lighting\t60\t
-30\t-33840.56\t-28943.84
0\t-29921.04\t-25360.4
30\t-49096.61\t-42487.36
\t\t
"""
RTD = """\
OPTIS - Anisotropic BSDF surface file v1.0\t\t\t
SampleID:\tSample 60\t \t
0 1 0\t\t\t
1\t0\t\t
0\t\t\t
1\t\t\t
3\t\t\t
0 45 90\t\t\t
10 0\t\t\t
Reflection Spectrum\t\t\t
2\t\t\t
100 50\t\t\t
1000 50\t\t\t
\t-90\t-80\t
-30\t-33840.56\t-28943.84\t
0\t-29921.04\t-25360.4\t
30\t-49096.61\t-42487.36\t
\t\t\t
\t0\t180\t190
0\t-29921.04\t-27640.72\t-25360.4
30\t-49096.61\t-38163.96\t-28943.84
\t\t\t
"""
TEXTS = [(fred, FRED), (eds, EDS), (pab, PAB), (reflectance_factors, FACTORS), (reflet, REFLET), (speos_rtd, RTD)]


def read(module: ModuleType, path: Path, text: str) -> Any:
    path.write_bytes(text.encode())
    return only_list(module.read(path))


@pytest.mark.parametrize(("module", "text"), TEXTS)
@pytest.mark.parametrize("ends", ["\r", "\r\n"])
def test_line_ends_make_no_difference_and_no_other_format_takes_the_file(
    tmp_path: Path, module: ModuleType, text: str, ends: str
) -> None:
    path, other = tmp_path / "a", tmp_path / "b"
    path.write_bytes(text.encode())
    other.write_bytes(text.replace("\n", ends).encode() + b"\x1a")
    assert [each for each, _ in TEXTS if each.recognise(other.read_bytes())] == [module]
    for one, two in zip(module.read(path).parts, module.read(other).parts, strict=True):
        np.testing.assert_array_equal(rows(one), rows(two))
        assert one.comments == two.comments


@pytest.mark.parametrize(("module", "text"), TEXTS)
def test_blanks_and_case_make_no_difference(tmp_path: Path, module: ModuleType, text: str) -> None:
    path, other = tmp_path / "a", tmp_path / "b"
    path.write_bytes(text.encode())
    spaced = text.upper().replace("\t", "\t " if module is speos_rtd else "   ").replace("\n", "  \n")
    other.write_bytes(spaced.encode())
    assert module.recognise(other.read_bytes())
    for one, two in zip(module.read(path).parts, module.read(other).parts, strict=True):
        np.testing.assert_array_equal(rows(one), rows(two))


def test_fred_counts_azimuths_from_the_specular_ray(tmp_path: Path) -> None:
    found = read(fred, tmp_path / "a.txt", FRED)
    assert found.sigma_deg.tolist() == [10, 10, 10, 30, 30]
    assert found.values.tolist() == [0.031984, 0.0348, -1e-6, 0.020408, 0.042017]
    theta, _ = found.specular()
    np.testing.assert_allclose(theta[[1, 4]], 0.0, atol=1e-9)
    assert found.azimuth_deg[2] == 320.0
    assert found.isotropic
    assert any("mirror image" in line for line in found.comments)


def test_fred_has_factors_in_plane_scans_and_several_azimuths(tmp_path: Path) -> None:
    # The second example of FRED's help, in the plane, and its factor.
    text = "! a scan\nType bsdf_data\nFormat angles=deg  scale = 2\n15 0\n-30 0 0.0003\n15 0 0.1\n15 20\n0 0 1\n"
    found = read(fred, tmp_path / "a.txt", text)
    assert found.values.tolist() == [0.0006, 0.2, 2.0]
    assert found.azimuth_deg.tolist() == [180.0, 0.0, 0.0]
    assert (found.psi_deg.tolist(), found.isotropic) == ([180.0, 180.0, 200.0], False)
    assert "a scan" in found.comments


def test_fred_may_descend_or_have_the_specular_direction_alone(tmp_path: Path) -> None:
    head = FRED[: FRED.index("10\t0")]
    downward = "10 0\n80 0 1\n40 0 2\n0 0 3\n30 0\n80 0 4\n40 0 5\n0 0 6\n"
    assert read(fred, tmp_path / "a.txt", head + downward).sigma_deg.tolist() == [10.0] * 3 + [30.0] * 3
    assert "line 5: two numbers, which continue" in refusal(
        fred.read, tmp_path / "a.txt", head + downward.replace("40 0 2", "40 0")
    )
    specular = "10 0\n10 0 1\n20 0\n20 0 2\n30 0\n30 0 3\n"
    assert read(fred, tmp_path / "a.txt", head + specular).polar_deg.tolist() == [10.0, 20.0, 30.0]


def test_freds_export_with_the_specular_ray_in_each_line_is_read(tmp_path: Path) -> None:
    # data/raw/_imported/Z306_from_FRED_20260811 (ua-loft/bsdf-tools), shortened.
    text = FRED[: FRED.index("10\t0")] + (
        "angles measured from local surface normal\nAOI\t10\tdeg.\nFRED TIS integral (0-1)\t2.1E-02\n"
        "Spec Polar [deg.]\tSpec Azimuth [deg.]\tScatter Polar [deg.]\tScatter Azimuth [deg.]\tBSDF [1/sr]\n"
        "10\t0\t10\t0\t1.793E-02\n10\t0\t89.9\t10\t6.4E-03\n"
    )
    found = read(fred, tmp_path / "a.txt", text)
    assert found.values.tolist() == [0.01793, 0.0064]
    np.testing.assert_allclose(found.specular()[0][0], 0.0, atol=1e-9)
    assert "AOI\t10\tdeg." in found.comments


@given(values=scattered())
@settings(deadline=None)
def test_any_text_of_fred_is_read_as_it_was_meant(tmp_path_factory: pytest.TempPathFactory, values: Any) -> None:
    values = values.where(np.isnan(values.wavelength_nm) | (values.wavelength_nm == values.wavelength_nm[0]))
    values = ScatteredBsdf(*(getattr(values, each) for each in ("sigma_deg", "psi_deg", "polar_deg", "azimuth_deg", "values")))
    path = tmp_path_factory.mktemp("fred") / "a.txt"
    lines = ["type bsdf_data", "format angles=deg bsdf=value scale=1"]
    for k in range(values.size):
        # In five columns, because lines of two and three are ambiguous where directions continue each other.
        angles = values.sigma_deg[k], (values.psi_deg[k] + 180.0) % 360.0, values.polar_deg[k], values.azimuth_deg[k]
        lines.append(" ".join(f"{each:.10g}" for each in (*angles, values.values[k])))
    path.write_text("\n".join(lines))
    found = only_list(fred.read(path))
    about_light = (values.azimuth_deg - values.psi_deg) % 360.0
    np.testing.assert_allclose(found.values, values.values)
    np.testing.assert_allclose((found.azimuth_deg - found.psi_deg - about_light + 180.0) % 360.0, 180.0, atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("bsdf=value", "bsdf=log", "line 2: 'bsdf=log' is not read; export angles=deg bsdf=value"),
        ("angles=deg", "angles=sin", "line 2: 'angles=sin' is not read"),
        ("scale=1", "scale=one", "line 2: scale: 'one' is not a number"),
        ("format", "# ", "it has 0 lines that begin with format"),
        ("0.0348", "", "line 5: two numbers, which continue the polar angles of the lines around"),
        ("10\t0\n0", "0", "line 3: no line with the two angles of the incidence precedes"),
        ("0.031984", "0,031984", "line 4: '0,031984' has a decimal comma"),
        ("10\t140", "100\t140", "line 6: the polar angle of observation 100 deg is outside -90 to 90 deg"),
        ("0.020408\n30\t0\t0.042017", "0.020408\n90\t0", "line 9: two numbers, and no line of three follows"),
        ("0.0348", "0.0348 7", "line 5: 4 numbers in a line of 3"),
    ],
)
def test_a_damaged_text_of_fred_is_refused(tmp_path: Path, old: str, new: str, wanted: str) -> None:
    assert wanted in refusal(fred.read, tmp_path / "a.txt", FRED.replace(old, new, 1))


def test_an_engineered_diffuser_sends_light_on(tmp_path: Path) -> None:
    found = read(eds, tmp_path / "a.txt", EDS)
    assert (found.sample, found.transmitted.all(), found.size) == ("EDS10", True, 5)
    theta, _ = found.specular()
    np.testing.assert_allclose(theta[3], 0.0, atol=1e-9)
    whose = "the direction in which the light goes on"
    assert f"the azimuth of the incidence is that of {whose}, as the values show" in found.comments
    # The same file of a program that counts from the light.
    other = read(eds, tmp_path / "b.txt", EDS.replace("10 345\n0", "10 165\n0"))
    np.testing.assert_allclose(other.specular()[0], theta, atol=1e-9)


def test_a_folder_of_files_is_one_table(tmp_path: Path) -> None:
    for at in (0, 10, 20):
        (tmp_path / f"EDS10_{at}-345.txt").write_text(EDS.replace("10-345", f"{at}-345").replace("10 345\n0", f"{at} 345\n0"))
    (tmp_path / "README.txt").write_text("about the files")
    found = only_list(eds.read(tmp_path))
    assert (found.size, np.unique(found.sigma_deg).tolist()) == (15, [0.0, 10.0, 20.0])
    assert found.isotropic
    (tmp_path / "EDS20.txt").write_text(EDS.replace("EDS10", "EDS20"))
    assert eds.read(tmp_path).samples == ("EDS10", "EDS20")
    (tmp_path / "damaged.txt").write_text(EDS.replace("20.0", "2o"))
    assert "/damaged.txt, line 6: '2o' is not a number" in refusal(eds.read, tmp_path)
    (tmp_path / "none").mkdir()
    assert "none of its files is of this format" in refusal(eds.read, tmp_path / "none")


def test_pab_has_both_sides_in_one_system(tmp_path: Path) -> None:
    found = read(pab, tmp_path / "a.txt", PAB)
    assert (found.sample, found.sigma_deg.tolist(), found.psi_deg.tolist()) == ("blind", [30.0, 30.0], [10.0, 10.0])
    assert (found.polar_deg.tolist(), found.transmitted.tolist()) == ([15.0, 30.0], [False, True])
    assert "the upper edge of the sample is at azimuth 90 deg of the file" in found.comments
    # Light from behind: pabopto2bsdf -t turns the sample so, theta to 180 - theta and phi to 360 - phi.
    behind = read(pab, tmp_path / "b.txt", PAB.replace("30 10", "150 10"))
    assert (behind.sigma_deg.tolist(), behind.psi_deg.tolist(), behind.back.all()) == ([30.0, 30.0], [350.0, 350.0], True)
    assert (behind.azimuth_deg.tolist(), behind.transmitted.tolist()) == ([170.0, 350.0], [True, False])


def test_pab_has_cosines_and_colours(tmp_path: Path) -> None:
    text = PAB.replace("BSDF", "DSF").replace("150 10", "120 10")
    assert pab.recognise(text.encode())
    with_cosine = read(pab, tmp_path / "a.txt", text)
    np.testing.assert_allclose(with_cosine.values, [0.25 / np.cos(np.radians(15)), 1.0])
    text = PAB.replace("#upphi 90", "#colorimetry: CIE-XYZ").replace("0.25", "0.2 0.3 0.4").replace("0.5", "1 2 3")
    colours = read(pab, tmp_path / "b.txt", text)
    assert colours.channel.tolist() == ["X", "X", "Y", "Y", "Z", "Z"]
    assert colours.values.tolist() == [0.2, 1.0, 0.3, 2.0, 0.4, 3.0]


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("#incident_angle 30 10\n", "", "intheta and inphi of the light are not given"),
        ("30 10", "30", "line 3: '30' are not the angles intheta and inphi"),
        ("theta phi BSDF", "theta phi counts", "line 2: the columns 'theta phi counts' are not known"),
        ("#format: theta phi BSDF\n", "", "the line of its format is missing"),
        ("150 10 0.5", "190 10 0.5", "line 6: theta 190 deg is outside 0 to 180 deg"),
        ("150 10 0.5", "150 10", "line 6: 2 numbers in a line of 3"),
        ("15 190 0.25\n150 10 0.5\n", "", "it has no values"),
    ],
)
def test_a_damaged_text_of_pab_is_refused(tmp_path: Path, old: str, new: str, wanted: str) -> None:
    assert wanted in refusal(pab.read, tmp_path / "a.txt", PAB.replace(old, new, 1))


def test_reflectance_factors_are_pi_times_the_bsdf(tmp_path: Path) -> None:
    found = read(reflectance_factors, tmp_path / "a.txt", FACTORS)
    np.testing.assert_allclose(found.values * np.pi, [1.0, 0.5, 0.99, 1.02, np.nan, 1.01])
    assert found.wavelength_nm.tolist() == [385.65] * 3 + [1064.0] * 3
    assert (found.sample, found.sigma_deg.tolist()[:3], found.isotropic) == ("a panel, (2 inch)", [0.0, 45.0, 0.0], False)


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("BRF Values", "Values", "do not state that the values are reflectance factors"),
        ("1.064um", "red", "line 3: 'red' is not the name of a band"),
        ("1.064um", "385.65nm", "line 3: no band follows the angles, or one is there twice"),
        ("\t1.02", "", "line 4: 5 numbers in a line of 6"),
        ("\t180.000", "\t1800", "line 4: view_a 1800 deg is outside -360 to 360 deg"),
    ],
)
def test_a_damaged_list_of_factors_is_refused(tmp_path: Path, old: str, new: str, wanted: str) -> None:
    assert wanted in refusal(reflectance_factors.read, tmp_path / "a.txt", FACTORS.replace(old, new, 1))


def test_a_second_measurement_of_a_sample_is_another_part(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(REFLET + REFLET.replace("\t60\t", "\t0\t") + REFLET)
    parts = reflet.read(tmp_path / "a.txt").scattered
    assert [(part.sample, part.size) for part in parts] == [("paint 7", 12), ("paint 7, measurement 2", 6)]
    assert parts[0].sigma_deg.tolist() == [60.0] * 6 + [0.0] * 6
    assert parts[0].values[:2].tolist() == [-33840.56, -28943.84]
    # theta 30 at phi -90 is in the half plane of the specular ray.
    assert (parts[0].polar_deg[4], parts[0].azimuth_deg[4]) == (30.0, 180.0)


def test_the_speos_export_has_the_measured_table_and_its_own(tmp_path: Path) -> None:
    (tmp_path / "a.rtd").write_text(RTD)
    (tmp_path / "a.txt").write_text(REFLET)
    measured, own = speos_rtd.read(tmp_path / "a.rtd").scattered
    (text,) = reflet.read(tmp_path / "a.txt").scattered
    np.testing.assert_array_equal(rows(measured), rows(text))
    assert (measured.sample, own.sample, own.size) == ("Sample 60", "Sample 60, table 2", 6)
    # Where the second table has a measured direction, it has its value.
    same = {(p, a % 360): v for p, a, v in zip(measured.polar_deg, measured.azimuth_deg, measured.values, strict=True)}
    at = [k for k in range(own.size) if own.polar_deg[k] > 0 and own.azimuth_deg[k] in (180.0, 10.0)]
    assert [same[own.polar_deg[k], own.azimuth_deg[k]] for k in at] == own.values[at].tolist()
    assert len(at) == 2


@pytest.mark.parametrize(
    ("module", "old", "new", "wanted"),
    [
        (reflet, "BRDF", "BTDF", "line 2: it is not a BRDF: 'Intensity BTDF'"),
        (reflet, "Mode :\t0", "Mode :\t1", "line 4: it is a spectral measurement"),
        (reflet, "Theta sample :\t0", "Theta sample :\t30", "line 3: it has a sample that is turned"),
        (reflet, "0\t-29921.04\t-25360.4\n", "", "line 1: 2 lines of theta, and the keywords announce 3"),
        (reflet, "\t-25360.4", "", "line 14: 2 numbers in a line of 3"),
        (reflet, "Theta Lighting\t60", "Theta Lighting\t", "line 12: theta lighting is not stated"),
        (reflet, "Phi measure step :\t10", "Phi measure step :\t0", "line 11: phi from -90 to -80 in steps of 0 deg"),
        (reflet, "Phi measure step :\t10", "Phi measure step :\t1e-9", "line 11: phi from -90 to -80 in steps of 1e-09"),
        (speos_rtd, "Sample 60", "paint", "line 1: the sample's name 'paint' does not end with the incidence"),
        (speos_rtd, "1\t0\t\t", "0\t1\t\t", "line 4: '0 1' is not the mark of light that is reflected only"),
        (
            speos_rtd,
            "v1.0",
            "v8.0",
            "it begins with 'OPTIS - Anisotropic BSDF surface file v8...', and of Speos only exports of",
        ),
        (speos_rtd, "-28943.84\t\n", "\t\n", "line 15: 2 numbers in a line of 3"),
        (speos_rtd, "\t-90\t-80\t\n", "\t-80\t-90\t\n", "line 14: theta or phi of the table do not ascend"),
        (speos_rtd, RTD[RTD.index("\t-90") :], "", "line 1: no table follows the header"),
    ],
)
def test_a_damaged_export_is_refused(tmp_path: Path, module: ModuleType, old: str, new: str, wanted: str) -> None:
    text = RTD if module is speos_rtd else REFLET
    assert wanted in refusal(module.read, tmp_path / "a.txt", text.replace(old, new, 1))
