"""The instrument signature is subtracted where it was measured, with its uncertainty."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from tests.app.campaign.campaign_bench import QUIET, remove_checksums
from tests.app.campaign.reduction.grey_campaign import GLASS, STRAY, grey_plan, reduced
from tests.conftest import SMALL, Writer, changed


def test_the_signature_is_subtracted_where_it_was_measured_with_the_uncertainty_of_the_rig_file(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    plan = grey_plan(write_rig, write_schedule, "signature = true\n", twin=STRAY)
    run_campaign(plan, tmp_path / "a.journal")
    dataset = reduced(tmp_path / "a.journal")
    certain = dataset.samples["grey"].where(dataset.samples["grey"].good)
    assert float(np.median(certain.signature)) == pytest.approx(0.14, abs=0.03)
    assert np.abs((certain.bsdf - 0.03 / np.pi) / certain.u_bsdf).max() < 3.0
    assert any("without a sample" in note for note in dataset.notes)
    with sqlite3.connect(tmp_path / "a.journal") as journal:
        ((rig,),) = journal.execute("SELECT value FROM campaign WHERE key = 'rig'")
        other = changed(rig, (("signature_uncertainty = 0.01", "signature_uncertainty = 0.3"),))
        journal.execute("UPDATE campaign SET value = ? WHERE key = 'rig'", (other,))
        remove_checksums(journal)
    uncertain = reduced(tmp_path / "a.journal").samples["grey"]
    uncertain = uncertain.where(uncertain.good)
    signature = certain.signature / (1.0 - certain.signature)  # over the rest of the signal
    added = np.sqrt(uncertain.u_bsdf**2 - certain.u_bsdf**2) / certain.bsdf
    # What it is with a sample mounted is one error of sample and etalon, whose share of the signal is as 0.03 to 0.99 of it.
    assert added == pytest.approx(np.sqrt(0.3**2 - 0.01**2) * signature * (1.0 - 0.03 / 0.99), rel=0.005)
    assert any("a standard uncertainty of 1 %" in note for note in dataset.notes)


def test_a_signature_that_was_not_measured_stays_in_the_value(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    run_campaign(grey_plan(write_rig, write_schedule, twin=STRAY), tmp_path / "a.journal")
    points = reduced(tmp_path / "a.journal").samples["grey"]
    assert np.isnan(points.signature).all()
    assert float(np.nanmedian(points.bsdf[points.good]) / (0.03 / np.pi)) > 1.1


@pytest.mark.long
def test_the_signature_is_subtracted_from_the_etalon_that_scales_transmitted_light(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """The frames' light is a tenth of a dark etalon's, and would lower the sample's values by as much."""
    dark = ('model = "lambertian"\nreflectance = 0.99', 'model = "lambertian"\nreflectance = 0.05\nside = "both"')
    factor = ("radiance_factor = 0.99", "radiance_factor = 0.05")
    tables = (("[twin.samples.etalon]", f"{GLASS}[twin.samples.etalon]"), ("[twin.light]", f"{STRAY}[twin.light]"))
    rig = read_rig(write_rig(*QUIET, dark, factor, *tables))
    changes = (("gaussian-5", "glass"), ("[1e8, 1e10]", "[1e10, 1e11]"))
    medians = []
    for signature in ("false", "true"):
        text = f'{SMALL}light = "transmitted"\nsignature = {signature}\n'
        journal = tmp_path / f"{signature}.journal"
        run_campaign(make_plan(read_schedule(write_schedule(*changes, text=text)), rig), journal)
        points = reduced(journal).samples["glass"]
        points = points.where(points.good & points.transmitted)
        medians.append(float(np.median(points.bsdf)) / (0.3 / np.pi))
    assert medians[0] < 0.97
    assert medians[1] == pytest.approx(1.0, abs=0.03)
