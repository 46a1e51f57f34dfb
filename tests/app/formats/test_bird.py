"""BiRD's JSON: against the structure of its public schemas, and its own example."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats import FormatError, bird
from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.metadata import InstrumentMetadata, Metadata, ReceiverMetadata, SampleMetadata, SourceMetadata

from .scattered import only_list, refusal, rows, scattered


def obj(required: str, optional: str = "", **properties: Any) -> dict[str, Any]:
    """An object with these properties and no others; texts, unless another schema is given."""
    names = {**{name: {"type": "string"} for name in f"{required} {optional}".split()}, **properties}
    return {"type": "object", "properties": names, "required": required.split(), "additionalProperties": False}


def column(*units: str, least: float | None = 0.0, below: float | None = None) -> dict[str, Any]:
    limits = {"minimum": least, "exclusiveMaximum": below}
    item = {"type": "number", **{name: limit for name, limit in limits.items() if limit is not None}}
    value = obj("unit", value={"type": "number", "minimum": 0})
    values = {"type": "array", "items": item}
    return obj("unit values", "name description comments", unit={"enum": list(units)}, values=values, uncertainty=value)


ADHOC = obj(
    "description unit type values",
    "name comments",
    values={"type": "array", "items": {"not": {"type": "object"}}},
)
NAMED = {"type": "object", "required": ["name"]}
# The structure of BRDF_JSON_schema/*_v1.0.json of BiRD-project/BiRD_view: brdf, data (commit 0b2edf8), metadata (abb260b),
# provenance, license, sample, instrumentation and software (00d7fee), adhoc_varible (0476cc0). Three lists of required names
# that their own schemas forbid are put right: see the docstring of the codec.
STRUCTURE = obj(
    "",
    metadata=obj(
        "schema id type timestamp provenance method instrumentation software sample environment",
        "description comments",
        schema={"type": "string", "pattern": "^https://"},
        id={"type": "string", "pattern": "^[a-z]+:"},
        type={"const": "BRDF"},
        provenance=obj(
            "organization location email contact_person",
            "website phone comments",
            location=obj("country city street building_nr postal_code", "county room_nr coordinates"),
            email={"type": "string", "pattern": "@"},
        ),
        license=obj("type rights_holder", "link email phone proprietary"),
        method={"enum": ["simulation", "measurement"]},
        instrumentation={
            "oneOf": [
                {"const": "NA"},
                obj(
                    "name illumination_system detection_system",
                    "model manufacturer serial_number operator_name comments",
                    illumination_system=NAMED,
                    detection_system=NAMED,
                    adhoc_section={"type": "object"},
                ),
            ]
        },
        software={"oneOf": [{"const": "NA"}, obj("name", "version author description comments")]},
        sample=obj(
            "name type dimensions shape zero_azimuth_location",
            "model manufacturer manufacturing_method treatment properties_symmetry comments origin_location",
            dimensions={"type": "object"},
            adhoc_section={"type": "object"},
        ),
        environment={"oneOf": [{"const": "NA"}, {"type": "object"}]},
        data_links={"type": "array"},
        adhoc_section={"type": "object"},
    ),
    data=obj(
        "theta_i phi_i theta_r phi_r BRDF",
        theta_i=column("rad", "deg", "°", below=90),
        phi_i=column("rad", "deg", "°", below=360),
        theta_r=column("rad", "deg", "°", below=90),
        phi_r=column("rad", "deg", "°", below=360),
        BRDF=column("1/sr", "sr^-1"),
        uBRDF=column("1/sr", "sr^-1", "%"),
        wavelength_i=column("nm", "μm"),
        wavelength_r=column("nm", "μm"),
        adhoc_variables={"type": "object", "additionalProperties": ADHOC},
    ),
)
STRUCTURE["required"] = ["metadata", "data"]
VALIDATOR = jsonschema.Draft202012Validator(STRUCTURE)

METADATA = Metadata(
    title="a paint",
    date="2026-11-22T21:00:00+01:00",
    operator="A. Person",
    laboratory="A Laboratory",
    licence="CC-BY-4.0",
    environment="23 °C",
    sample=SampleMetadata("7/3", "A Maker", "paint", azimuth_mark="arrow", preparation="wiped"),
    instrument=InstrumentMetadata("a goniophotometer", "goniotwin 0.1.0", 500.0),
    source=SourceMetadata("a laser", (550.0,)),
    receiver=ReceiverMetadata("photodiodes", 1e-4, gains_v_per_a=(1e6, 1e7)),
)


def faults(path: Path) -> list[str]:
    document = json.loads(path.read_text("utf-8"))
    return [f"{fault.json_path}: {fault.message[:200]}" for fault in VALIDATOR.iter_errors(document)]


@given(values=scattered(lowest=0.0), with_u=st.booleans(), back=st.booleans(), generated=st.booleans(), marked=st.booleans())
@settings(deadline=None)
def test_what_is_written_has_the_public_structure_and_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, values: Any, with_u: bool, back: bool, generated: bool, marked: bool
) -> None:
    path = tmp_path_factory.mktemp("bird") / "a.brdf"
    values = replace(
        values,
        back=np.full(values.size, back),
        generated=generated,
        sample="paint °",
        isotropic=False,
        comments=("one", "two"),
        sigma_deg=np.minimum(values.sigma_deg, 89.5),
        polar_deg=np.minimum(values.polar_deg, 89.5),
        u=0.01 * np.arange(values.size) if with_u else None,
        low95=values.values - 1.0 if marked else None,
        high95=values.values + 1.0 if marked else None,
        interval=np.full(values.size, "linear" if marked else ""),
        u_shared=np.full(values.size, 0.001 * marked),
        photodiode=np.arange(values.size) if marked else None,
        flags=np.full(values.size, 'dark "x"' if marked else ""),
    )
    bird.write(path, BsdfFile((values,), METADATA, ("three",)))
    assert not faults(path)
    again = bird.read(path)
    assert bird.recognise(path.read_bytes())
    found = only_list(again)
    names = ("back", "u_shared", "photodiode", *(("u",) if with_u else ()))
    np.testing.assert_array_equal(rows(found, *names), rows(values, *names))
    assert found.flags.tolist() == values.flags.tolist()
    assert found.interval.tolist() == values.interval.tolist()
    np.testing.assert_allclose([found.low95, found.high95], [values.low95, values.high95], rtol=1e-8)
    assert np.isfinite(found.u).all() == with_u
    assert (found.sample, found.isotropic, found.generated) == ("paint °", False, generated)
    assert set(found.comments) == {"one", "two", "three"}
    assert again.metadata == METADATA


def test_the_metadata_are_in_birds_own_fields(tmp_path: Path) -> None:
    values = ScatteredBsdf(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1), sample="paint")
    bird.write(tmp_path / "a.brdf", BsdfFile((values,), METADATA))
    document = json.loads((tmp_path / "a.brdf").read_text())
    about = document["metadata"]
    assert about["provenance"]["organization"] == "A Laboratory"
    assert about["instrumentation"]["detection_system"]["solid_angle"] == {"value": 1e-4, "unit": "sr"}
    assert about["sample"]["zero_azimuth_location"] == "arrow"
    # Another program keeps these fields and drops what it does not know.
    del about["adhoc_section"]
    (tmp_path / "a.brdf").write_text(json.dumps(document))
    again = bird.read(tmp_path / "a.brdf").metadata
    assert (again.operator, again.laboratory, again.date, again.licence) == (
        METADATA.operator,
        METADATA.laboratory,
        METADATA.date,
        METADATA.licence,
    )
    assert (again.instrument.name, again.source.description, again.receiver.solid_angle_sr) == (
        "a goniophotometer",
        "a laser",
        1e-4,
    )


def test_nothing_stated_is_na(tmp_path: Path) -> None:
    values = ScatteredBsdf(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1))
    bird.write(tmp_path / "a.brdf", BsdfFile((values,)))
    assert not faults(tmp_path / "a.brdf")
    again = bird.read(tmp_path / "a.brdf")
    assert (again.metadata, again.samples) == (Metadata(), ("",))


# Example.brdf of BiRD-project/BiRD_view ("Test BRDF data files", commit dd38750), shortened.
EXAMPLE: dict[str, Any] = {
    "metadata": {
        "schema": bird.SCHEMA,
        "id": "https://example.invalid/1",
        "type": "BRDF",
        "timestamp": "2022-01-14T12:00:00+02",
        "provenance": {"organization": "Aalto University", "contact_person": "A. Person"},
        "license": {"type": "BY-SA", "rights_holder": "Aalto University"},
        "method": "measurement",
        "instrumentation": {"name": "Aalto reference gonioreflectometer", "operator_name": "A. Person"},
        "software": {"name": "a program"},
        "sample": {"name": "SRT1", "manufacturer": "Labsphere", "properties_symmetry": "isotropic"},
        "environment": {"temperature": {"value": 23.2, "unit": "°C"}},
    },
    "data": {
        "wavelength_i": {"unit": "nm", "values": [550, 550, 650, 650]},
        "polarization_i": {"notation": "inStokes", "values": [[1, 1, 0, 0], [1, -1, 0, 0], [1, 1, 0, 0], [1, -1, 0, 0]]},
        "theta_i": {"unit": "°", "values": [0, 0, 0, 0]},
        "phi_i": {"unit": "°", "values": [0, 0, 0, 0]},
        "theta_r": {"unit": "°", "values": [10, 10, 10, 10]},
        "phi_r": {"unit": "°", "values": [60, 60, 60, 60]},
        "BRDF": {"unit": "sr^-1", "values": [0.254, 0.263, 0.267, 0.273]},
    },
}


def test_each_state_of_polarisation_is_a_sample(tmp_path: Path) -> None:
    (tmp_path / "a.brdf").write_text(json.dumps(EXAMPLE))
    found = bird.read(tmp_path / "a.brdf")
    assert found.samples == ("SRT1, polarisation s", "SRT1, polarisation p")
    assert [part.values.tolist() for part in found.scattered] == [[0.254, 0.267], [0.263, 0.273]]
    assert [rows(part)[4].tolist() for part in found.scattered] == [[550, 650]] * 2
    assert found.metadata.environment == "temperature 23.2 °C"
    assert found.metadata.laboratory == "Aalto University"


def test_the_older_layout_radians_and_relative_uncertainties_are_read(tmp_path: Path) -> None:
    # As help_text.py of BiRD_view has it: variables, and a row of their values for each direction.
    variables = [("theta_i", "rad"), ("phi_i", "rad"), ("theta_r", "deg"), ("phi_r", "deg"), ("BRDF", "sr-1"), ("uBRDF", "%")]
    document = {
        "metadata": {"id": "1", "type": "BRDF", "sample": "sand", "simulation": "NA"},
        "data": {
            "variables": [{"name": n, "type": "number", "unit": u, "description": ""} for n, u in [*variables, ("spot", "mm")]],
            "values": [[np.pi / 6, np.pi, 20, 0, 0.5, 2, 1], [np.pi / 6, 0, -20, 0, 0.25, 4, 1]],
        },
    }
    (tmp_path / "a.json").write_text(json.dumps(document))
    found = only_list(bird.read(tmp_path / "a.json"))
    assert (found.sample, found.sigma_deg.tolist(), found.psi_deg.tolist()) == ("sand", [30.0, 30.0], [180.0, 0.0])
    assert (found.polar_deg.tolist(), found.azimuth_deg.tolist()) == ([20.0, 20.0], [0.0, 180.0])
    np.testing.assert_allclose(found.u, [0.01, 0.01])
    assert "columns that are not read: 'spot'" in found.comments
    assert any("coverage factor" in line for line in found.comments)


def changed(**columns: Any) -> dict[str, Any]:
    return {"metadata": EXAMPLE["metadata"], "data": {**EXAMPLE["data"], **columns}}


@pytest.mark.parametrize(
    ("document", "wanted"),
    [
        ([1], 'it has no object "data"'),
        (changed(BRDF={"unit": "sr^-1", "values": [0.1]}), "has 4 values, and BRDF has 1"),
        (changed(BRDF={"unit": "%", "values": [0.1] * 4}), "BRDF has the unit '%'; give 1/sr"),
        (changed(BRDF={"unit": "1/sr", "values": [0.1, "x", 1, 1]}), "BRDF has at place 2 what is no number"),
        (changed(BRDF={"unit": "1/sr", "values": [True] * 4}), "BRDF has at place 1 what is no number"),
        (changed(BRDF={"unit": "1/sr", "values": [1e308, 10**400, 1, 1]}), "BRDF has values that are not finite"),
        (changed(BRDF={"unit": "1/sr", "values": []}), "it has no values"),
        (changed(theta_r={"unit": "deg", "values": [10, 100, 1, 1]}), "theta_r has at place 2 100 deg"),
        (changed(phi_r={"unit": "deg", "values": [None, 1, 1, 1]}), "phi_r has values that are not finite"),
        (changed(phi_r=[1, 2, 3, 4]), "the column phi_r is missing"),
        (changed(wavelength_r={"unit": "nm", "values": [1, 2, 3, 4]}), "leave fluorescence out"),
        (changed(uBRDF={"unit": "%", "values": [1, -2, 3, 4]}), "uBRDF has negative values"),
        ({"data": {"variables": [{}], "values": [[1, 2]]}}, "row 1 has not 1 values"),
    ],
)
def test_a_file_that_is_not_whole_is_refused(tmp_path: Path, document: Any, wanted: str) -> None:
    assert wanted in refusal(bird.read, tmp_path / "a.brdf", json.dumps(document))


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("[" * 100_000, "lists in lists without end"),
        ('{"a":\n', "line 2: not JSON"),
        ('{"a": 1' + "0" * 5000 + "}", "not JSON of this format"),
        ('{"data": {"BRDF": {"unit": "1/sr", "values": [Infinity]}}}', "Infinity is not a finite number"),
    ],
)
def test_damaged_json_is_refused(tmp_path: Path, text: str, wanted: str) -> None:
    assert wanted in refusal(bird.read, tmp_path / "a.brdf", text)


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"transmitted": np.array([True, False])}, "some is transmitted"),
        ({"channel": np.array(["X", "X"])}, "these values are of colours"),
        ({"back": np.array([True, False])}, "there are both"),
        ({"wavelength_nm": np.array([1.0, np.nan])}, "no room for grey and spectral values"),
        ({"values": np.full(2, np.nan)}, "no value to write"),
    ],
)
def test_what_bird_cannot_hold_is_refused(tmp_path: Path, change: dict[str, Any], wanted: str) -> None:
    values = ScatteredBsdf(np.zeros(2), np.zeros(2), np.arange(2.0), np.zeros(2), np.arange(2.0))
    with pytest.raises(FormatError, match=wanted):
        bird.write(tmp_path / "a.brdf", BsdfFile((replace(values, **change),)))
    assert not (tmp_path / "a.brdf").exists()


def test_values_beyond_the_schemas_limits_are_written_and_counted(tmp_path: Path) -> None:
    values = ScatteredBsdf(np.zeros(3), np.zeros(3), np.array([0.0, 45.0, 90.0]), np.zeros(3), np.array([-1e-6, np.nan, 1.0]))
    bird.write(tmp_path / "a.brdf", BsdfFile((values,)))
    document = json.loads((tmp_path / "a.brdf").read_text())
    assert document["data"]["BRDF"]["comments"] == "1 values are below 0, as measured; 1 directions are at 90 deg"
    assert "1 directions without a value are not written" in document["metadata"]["comments"]
    assert len(faults(tmp_path / "a.brdf")) == 2
    assert only_list(bird.read(tmp_path / "a.brdf")).values.tolist() == [-1e-6, 1.0]


def test_a_value_without_uncertainty_has_its_own_size(tmp_path: Path) -> None:
    values = ScatteredBsdf(
        np.zeros(2), np.zeros(2), np.arange(2.0), np.zeros(2), np.array([0.5, -2.0]), np.array([0.1, np.nan])
    )
    bird.write(tmp_path / "a.brdf", BsdfFile((values,)))
    column = json.loads((tmp_path / "a.brdf").read_text())["data"]["uBRDF"]
    assert (column["values"], column["comments"]) == ([0.1, 2.0], f"{bird.ABOUT_U}; 1 are unknown, and are the value itself")
