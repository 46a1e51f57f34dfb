"""The metadata of a campaign: what a person states in the schedule, and what rig file, journal and reduction know."""

import math
import re
import tomllib
from dataclasses import asdict

import pytest

from goniotwin.app.campaign.journal.mounting import MOUNTED, event_words, mounting_text
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.metadata import listed_values
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import ScheduleFile, read_schedule
from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.errors import UserError
from goniotwin.app.formats.metadata import Metadata, SampleMetadata, metadata_from_dict
from goniotwin.app.rig import read_rig
from tests.app.campaign.reduction.grey_campaign import reduced
from tests.conftest import REPOSITORY, SCHEDULE, SMALL, Change, Writer

(STATED,) = re.findall(
    r"```toml\n(\[metadata\].*?)```", (REPOSITORY / "docs" / "operate" / "schedule.md").read_text(encoding="utf-8"), re.S
)


def metadata(write_rig: Writer, write_schedule: Writer, schedule: str, *rig: Change) -> Metadata:
    path = write_schedule(text=schedule)
    plan = make_plan(read_schedule(path), read_rig(write_rig(*rig)))
    journal = path.with_suffix(".journal")
    journal.unlink(missing_ok=True)
    run_without_wires(plan, journal)
    return reduced(journal).metadata["gaussian-5"]


def test_what_a_person_states_and_what_rig_and_journal_know_are_the_metadata(write_rig: Writer, write_schedule: Writer) -> None:
    drift = "[drift]\nevery_s = 60.0\nsigma_deg = 30.0\nbeta_deg = 180.0\nwavelength_nm = 550.0\n"
    found = metadata(
        write_rig,
        write_schedule,
        f"{SMALL}signature = true\n{drift}{STATED}",
        ("[etalon] ", "[light]\nbandwidth_nm = 4.0\n\n[etalon] "),
        ("radiance_factor = 0.99", "radiance_factor = 0.99\ncalibrated = 2026-01-15"),
    )
    stated = tomllib.loads(STATED)["metadata"]
    assert asdict(found.sample) == {**asdict(SampleMetadata()), **stated["samples"]["gaussian-5"]}
    names = ("title", "operator", "laboratory", "environment", "licence")
    assert {name: getattr(found, name) for name in names} == {name: stated[name] for name in names}
    assert (found.source.description, found.receiver.description) == (stated["source"], stated["receiver"])
    assert found.instrument.name == f"{stated['instrument']} (virtual goniophotometer)"
    assert found.reference.name == stated["reference"]
    assert (found.reference.certificate, found.reference.date) == (stated["certificate"], "2026-01-15")
    assert found.reference.relative_uncertainty == 0.002
    # Nominal dimensions: a disc of 5 mm at 300 mm, and a pupil of 5 mm radius at 800 mm.
    assert found.receiver.solid_angle_sr == pytest.approx(math.pi * 2.5**2 / 300.0**2)
    assert found.source.divergence_deg == pytest.approx(math.degrees(2.0 * math.atan(5.0 / 800.0)))
    assert (found.source.wavelengths_nm, found.source.bandwidth_nm, found.source.spot_mm) == ((550.0,), 4.0, 5.0)
    assert "linearly polarised" in found.source.polarisation
    assert found.receiver.field_of_view_deg == 0.5
    assert found.quality.drift == "checked every 60 s at sigma 30 deg, limit 0.5 %; no check is beyond it"
    assert found.quality.signature == "measured without a sample and subtracted; taken as the same to 1 % with a sample"
    assert found.quality.repeats == 1
    assert re.fullmatch(r"\d+ rows in the chain of checksums, tip [0-9a-f]{64}", found.raw_data)
    assert "sigma 30, gamma 0, beta 180, shift 0, 1 deg" in found.geometry
    assert found.date[:2] == "20"
    assert metadata_from_dict(found.as_dict()) == found


def test_gains_and_noise_floor_are_those_of_the_values(write_rig: Writer, write_schedule: Writer) -> None:
    low, high = (metadata(write_rig, write_schedule, SMALL.replace("[1e8, 1e10]", gains)) for gains in ("[1e8]", "[1e8, 1e10]"))
    assert low.receiver.gains_v_per_a == (1e8,)
    assert high.receiver.gains_v_per_a == (1e8, 1e10)
    assert low.quality.noise_floor_per_sr is not None
    assert high.quality.noise_floor_per_sr is not None
    assert 0.0 < 10.0 * high.quality.noise_floor_per_sr < low.quality.noise_floor_per_sr < 0.1


def test_a_schedule_without_metadata_has_those_of_rig_and_journal_alone(write_rig: Writer, write_schedule: Writer) -> None:
    found = metadata(write_rig, write_schedule, SMALL)
    assert (found.title, found.operator, found.licence) == ("small", "", "")
    assert (found.sample.identifier, found.sample.side, found.instrument.name) == (
        "gaussian-5",
        "front",
        "virtual goniophotometer",
    )
    assert (found.reference.name, found.reference.certificate) == ("etalon", "[etalon] of the rig file")
    assert (found.quality.drift, found.quality.signature) == ("no drift checks", "not measured, not corrected")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[metadata]\noperator = "A\\nB"', r"metadata\.operator: has a line break, a tab or another control character"),
        ('[metadata]\nopreator = "A"', r"metadata\.opreator: there is no such key; did you mean 'operator'\?"),
        ('[metadata.samples.paper]\nmaker = "A"', r"metadata\.samples: 'paper' is not among the samples; name one of them"),
        ("[metadata]\nlicence = 4", r"metadata\.licence: should be text|metadata\.licence: .*string"),
        ("[metadata.samples.gaussian-5]\nthickness_mm = 0", r"samples\.gaussian-5\.thickness_mm: .*greater than 0"),
        ("[metadata.samples.gaussian-5]\npicture_sha256 = 'ab'", r"samples\.gaussian-5\.picture_sha256: "),
        (
            "[metadata.samples.gaussian-5]\nmounted_at = 2026-01-31T14:05:00",
            r"samples\.gaussian-5\.mounted_at: should be a time with its offset from UTC, such as .*, not 2026-01-31T14:05:00",
        ),
        ("[metadata.samples.gaussian-5]\nmounted_at = 'noon'", r"mounted_at: should be a time with its offset .*, not noon"),
    ],
)
def test_metadata_that_are_wrong_are_refused_in_one_line(write_schedule: Writer, text: str, message: str) -> None:
    path = write_schedule(text=f"{SMALL}{text}\n")
    with pytest.raises(UserError, match=message) as caught:
        read_schedule(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("quote", ["", "'"])
def test_a_time_is_a_date_time_of_toml_or_a_text(write_schedule: Writer, quote: str) -> None:
    stamp = f"mounted_at = {quote}2026-01-31T14:05:00+01:00{quote}"
    path = write_schedule(text=f"{SMALL}[metadata.samples.gaussian-5]\n{stamp}\nthickness_mm = 2\n")
    assert read_schedule(path).file.metadata.samples["gaussian-5"].stated == {
        "mounted_at": "2026-01-31T14:05:00+01:00",
        "thickness_mm": 2.0,
    }


def test_a_mounting_is_a_sentence_and_a_damaged_one_stays_as_it_is() -> None:
    record = SampleMetadataTable(thickness_mm=1.5, mounted_by="A. Person")
    assert event_words(MOUNTED, mounting_text("satin", record)) == "Mounted satin: thickness mm 1.5, mounted by A. Person"
    assert event_words(MOUNTED, mounting_text("satin", SampleMetadataTable())) == "Mounted satin"
    assert event_words("sleep", '{"sample": "satin"}') == '{"sample": "satin"}'
    for damaged in ("{", "[1]", '{"thickness_mm": 1}'):
        assert event_words(MOUNTED, damaged) == damaged


def test_an_earlier_schedule_is_read_as_before() -> None:
    assert read_schedule(SCHEDULE).file.metadata == ScheduleFile.model_fields["metadata"].default


def test_the_values_of_a_grid_are_listed_in_few_words() -> None:
    assert listed_values([30.0]) == "30"
    assert listed_values([60.0, 0.0, 30.0, 45.0]) == "0, 30, 45, 60"
    assert listed_values([0.1 * k for k in range(40)]) == "0 to 3.9 by 0.1"
    assert listed_values([k * k for k in range(20)]) == "20 values from 0 to 361"
