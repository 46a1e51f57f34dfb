"""Certificate of the etalon: interpolation, range of validity, expiry, and its effect on the BSDF."""

from datetime import date
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.certificate import (
    CertificateTable,
    constant_certificate,
    parse_certificate,
    refuse_expired,
)
from goniotwin.app.campaign.schedule.file import ScheduleDescription, read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.file import EtalonTable
from goniotwin.protocols.clock import calendar_stamp
from tests.app.campaign.campaign_bench import QUIET
from tests.conftest import RIG, SMALL, Change, Writer

GRID = """# Spectralon, from its manufacturer
wavelength_nm, incidence_deg, zenith_deg, azimuth_deg, radiance_factor, relative_uncertainty
500, 0, 0, 0, 1.00, 0.002
500, 0, 0, 180, 1.00, 0.002
500, 0, 80, 0, 0.80, 0.004
500, 0, 80, 180, 0.90, 0.004
500, 60, 0, 0, 1.10, 0.002
500, 60, 0, 180, 1.10, 0.002
500, 60, 80, 0, 0.90, 0.004
500, 60, 80, 180, 1.00, 0.004
600, 0, 0, 0, 1.40, 0.002
600, 0, 0, 180, 1.40, 0.002
600, 0, 80, 0, 1.20, 0.004
600, 0, 80, 180, 1.30, 0.004
600, 60, 0, 0, 1.50, 0.002
600, 60, 0, 180, 1.50, 0.002
600, 60, 80, 0, 1.30, 0.004
600, 60, 80, 180, 1.40, 0.004
"""
BY_ZENITH = "zenith_deg, radiance_factor, relative_uncertainty\n0, 1.05, 0.003\n60, 0.85, 0.005\n"
TABLE = '\n[certificate]\nfile = "etalon.csv"\nexpires = {expires}\n'


def at(text: str, wavelength: float, incidence: float, zenith: float, azimuth: float) -> tuple[float, float]:
    factor, relative = parse_certificate(text, "c.csv").interpolate(
        wavelength, incidence, np.array([zenith]), np.array([azimuth])
    )
    return float(factor[0]), float(relative[0])


def test_values_between_the_lines_are_interpolated_linearly() -> None:
    assert at(GRID, 500, 0, 80, 180) == pytest.approx((0.90, 0.004))
    assert at(GRID, 600, 60, 80, 180) == pytest.approx((1.40, 0.004))
    assert at(GRID, 550, 0, 0, 0) == pytest.approx((1.2, 0.002))
    assert at(GRID, 550, 30, 40, 90) == pytest.approx((1.175, 0.003))


def test_both_sides_of_the_plane_of_incidence_are_alike() -> None:
    assert at(GRID, 500, 0, 80, 270) == at(GRID, 500, 0, 80, 90)
    assert at(GRID, 500, 0, 80, 359) == pytest.approx(at(GRID, 500, 0, 80, 1))


@pytest.mark.parametrize("point", [(499, 0, 0, 0), (601, 0, 0, 0), (550, 61, 0, 0), (550, 0, 81, 0)])
def test_there_is_no_value_outside_the_table(point: tuple[float, float, float, float]) -> None:
    assert np.isnan(at(GRID, *point)).all()


def test_a_certificate_without_a_column_is_valid_at_all_values_of_it() -> None:
    assert at(BY_ZENITH, 300, 77, 30, 123) == pytest.approx((0.95, 0.004))
    assert np.isnan(at(BY_ZENITH, 300, 77, 61, 0)).all()
    factor, relative = constant_certificate(EtalonTable(0.99, 0.002)).interpolate(550, 30, np.arange(0.0, 90.0), np.zeros(90))
    assert np.all(factor == 0.99)
    assert np.all(relative == 0.002)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("zenith_deg, radiance_factor\n0, 1\n", "relative_uncertainty is missing"),
        (BY_ZENITH.replace("zenith", "polar"), "unknown column 'polar_deg'"),
        (BY_ZENITH + "60, 0.8, 0.005\n", "line 4: is the second line"),
        (BY_ZENITH + "70, 0.8\n", "line 4: has 2 columns, the heading 3"),
        (BY_ZENITH + "70, white, 0.005\n", "line 4: could not convert"),
        (BY_ZENITH + "70, 0.0, 0.005\n", "line 4: radiance_factor must be above 0"),
        (BY_ZENITH + "45, 98, 0.005\n", "line 4: a radiance factor of 98 is above 1.5.* in percent, write 0.98"),
        (BY_ZENITH + "70, 85, 0.005\n", "line 4: a radiance factor of 85 is above 5"),
        (BY_ZENITH + "70, nan, 0.005\n", "line 4: a number is not finite"),
        (BY_ZENITH.splitlines()[0], "no line below"),
        ("\n".join(GRID.splitlines()[:-1]), "has 15 lines, but 2 x 2 x 2 x 2 combinations"),
    ],
)
def test_an_error_in_the_file_is_reported_with_its_line(text: str, message: str) -> None:
    with pytest.raises(UserError, match=rf"^c\.csv: .*{message}"):
        parse_certificate(text, "c.csv")


def test_an_expired_certificate_is_refused_without_a_responsible_person() -> None:
    table = CertificateTable(file="c.csv", expires=date(2026, 5, 1))
    refuse_expired(table, date(2026, 5, 1), "c.csv")
    with pytest.raises(UserError, match=r"expired on 2026-05-01; .*accept_expired_by"):
        refuse_expired(table, date(2026, 5, 2), "c.csv")
    refuse_expired(table.model_copy(update={"accept_expired_by": "Ada"}), date(2027, 1, 1), "c.csv")


def test_a_schedule_with_an_expired_certificate_is_refused_when_it_is_read(write_schedule: Writer) -> None:
    schedule = write_schedule(text=SMALL + TABLE.format(expires="2020-01-31"))
    (schedule.parent / "etalon.csv").write_text(BY_ZENITH)
    with pytest.raises(UserError, match=r"etalon\.csv: .*expired on 2020-01-31"):
        read_schedule(schedule)
    accepted = write_schedule(text=SMALL + TABLE.format(expires="2020-01-31") + 'accept_expired_by = "Ada"\n')
    assert read_schedule(accepted).certificate == BY_ZENITH
    (schedule.parent / "etalon.csv").unlink()
    with pytest.raises(UserError, match=r"etalon\.csv: cannot be read: .*the etalon's certificate"):
        read_schedule(accepted)


def test_a_second_standard_expires_too_and_a_turned_one_with_the_etalon(write_schedule: Writer) -> None:
    second = '[second_standard]\nname = "b"\nradiance_factor = 0.9\nrelative_uncertainty = 0.01\nexpires = 2020-01-31\n'
    with pytest.raises(UserError, match=r"second_standard: the second standard's certificate expired on 2020-01-31; .*accept_"):
        read_schedule(write_schedule(text=SMALL + second))
    assert read_schedule(write_schedule(text=SMALL + second + 'accept_expired_by = "Ada"\n')).file.second_standard is not None
    read_schedule(write_schedule(text=SMALL + second.replace("2020", "9999")))
    turned = '[second_standard]\nname = "b"\nturned = true\nexpires = 9999-01-31\n'
    with pytest.raises(UserError, match="expires: a turned etalon has the etalon's certificate"):
        read_schedule(write_schedule(text=SMALL + turned))


@pytest.mark.parametrize("where", ["rig", "certificate", "second", "second table"])
def test_a_calibration_in_the_future_is_refused(where: str, write_schedule: Writer, write_rig: Writer) -> None:
    future, text = "calibrated = 9999-01-01\n", SMALL
    if where == "certificate":
        text += TABLE.format(expires="9999-12-31")
    elif where == "second":
        text += f'[second_standard]\nname = "opal"\nradiance_factor = 0.9\nrelative_uncertainty = 0.01\n{future}'
    elif where == "second table":
        text += f'[second_standard]\nname = "opal"\ntable = """\n{future}{BY_ZENITH}"""\n'
    schedule = write_schedule(text=text)
    (schedule.parent / "etalon.csv").write_text(future + BY_ZENITH)
    rig = write_rig(*((("radiance_factor = 0.99\n", f"radiance_factor = 0.99\n{future}"),) if where == "rig" else ()))
    with pytest.raises(UserError, match="calibrated = 9999-01-01 is in the future"):
        make_plan(read_schedule(schedule), read_rig(rig))


def certified(write_schedule: Writer, text: str, *changes: Change) -> ScheduleDescription:
    year = int(calendar_stamp()[:4]) + 1
    path = write_schedule(*changes, text=SMALL + TABLE.format(expires=f"{year}-01-01"))
    (path.parent / "etalon.csv").write_text(text)
    return read_schedule(path)


def test_check_warns_of_directions_and_wavelengths_outside_the_certificate(write_schedule: Writer) -> None:
    rig = read_rig(RIG)

    def certificate_warnings(text: str, *changes: Change) -> list[str]:
        warnings = check_plan(make_plan(certified(write_schedule, text, *changes), rig)).warnings
        return [each for each in warnings if "etalon.csv" in each]

    (warning,) = certificate_warnings(BY_ZENITH)
    # Of 18 photodiodes at shifts of 0 and 1 deg, those beyond 60 deg: 61, and 65 to 86.
    assert "does not cover 11 of 36 directions" in warning
    assert "The certificate is valid for zenith_deg 0 to 60." in warning
    (warning,) = certificate_warnings(GRID, ("[550]", "[550, 610, 620]"))
    assert "does not cover 2 of 3 wavelengths and 3 of 36 directions" in warning  # 81, 85 and 86 deg
    assert not certificate_warnings("radiance_factor, relative_uncertainty\n0.98, 0.005\n")


@pytest.mark.parametrize(
    ("change", "quantity"),
    [(("[550]", "[610, 620]"), "the schedule's wavelengths"), (("[30]", "[61]"), "the schedule's directions")],
)
def test_a_certificate_that_covers_nothing_is_refused(change: Change, quantity: str, write_schedule: Writer) -> None:
    schedule = certified(write_schedule, GRID, change)
    with pytest.raises(
        UserError, match=rf"schedule\.toml: certificate\.file: etalon\.csv covers none of {quantity}.*500 to 600"
    ):
        make_plan(schedule, read_rig(RIG))


def test_a_percentage_in_the_rig_file_is_refused(write_rig: Writer) -> None:
    with pytest.raises(UserError, match=r"rig\.toml: etalon\.radiance_factor: .*write 0\.98"):
        read_rig(write_rig(("radiance_factor = 0.99", "radiance_factor = 98")))


def test_the_bsdf_follows_the_certificate_and_the_journal_keeps_it(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    rig = read_rig(write_rig(*QUIET))
    tomorrow = f"{int(calendar_stamp()[:4]) + 1}-01-01"
    plain = write_schedule(name="plain.toml")
    certified = write_schedule(text=SMALL + TABLE.format(expires=tomorrow))
    (tmp_path / "etalon.csv").write_text(BY_ZENITH)
    for schedule, name in ((plain, "plain"), (certified, "certified")):
        run_campaign(make_plan(read_schedule(schedule), rig), tmp_path / f"{name}.journal")
    (tmp_path / "etalon.csv").unlink()
    points = []
    for name in ("plain", "certified"):
        with Journal.open(tmp_path / f"{name}.journal") as journal:
            points.append(reduce_journal(journal).samples["gaussian-5"])
    plain_points, certified_points = points
    inside = plain_points.zenith_deg <= 60.0
    factor = 1.05 - 0.2 * plain_points.zenith_deg / 60.0
    # Before the correction of the field of view, which is that of the corrected values' own slopes.
    plain_values, certified_values = (each.bsdf * np.exp(-each.field_correction) for each in points)
    assert np.allclose(certified_values[inside], (plain_values * factor / 0.99)[inside], equal_nan=True)
    assert np.isnan(certified_points.bsdf[~inside]).all()
    assert np.array_equal(certified_points.flag("uncertified"), ~inside)
    assert not plain_points.flag("uncertified").any()
    bright = certified_points.where(inside & plain_points.good & (plain_points.theta_deg < 3.0))
    assert (bright.u_bsdf > 0.003 * bright.bsdf).all()
