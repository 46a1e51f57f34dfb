"""BiRD's universal BRDF format, JSON (EMPIR 16NRM08 and 18SIB03), with uncertainties: .brdf or .json.

    {"metadata": {...}, "data": {"theta_i": {"unit": "deg", "values": [...]}, ..., "BRDF": {...}, "uBRDF": {...}}}

The columns and the required fields are those of the schemas of version 1.0 (github.com/BiRD-project/BiRD_view, folder
BRDF_JSON_schema), whose example.brdf is read; an older layout, `variables` and rows of `values`, is read too. Angles are about
the normal, the zero of azimuth is a mark on the sample, values are 1/sr. What the schemas ask for and was not stated is "NA",
as the README wants; what they have no field for (all of this program's metadata, the side, flags) is in `adhoc_section` and
`adhoc_variables`, so that nothing is lost. Each state of polarisation is read as a sample of its own.

Three schemas ask for what they forbid (`name` in metadata; `index` and `type` of phi_r; `illumination` and `detection`): no
file can satisfy those, and the example leaves them out. The schema's limits of values (BRDF at least 0, polar angles below 90)
are not forced upon measured values; a comment counts those beyond.
"""

import hashlib
import json
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.errors import printable
from goniotwin.app.formats.content import ABSENT, BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, StrPath, name_file, quote_word
from goniotwin.app.formats.lists import BEYOND_DEG, MOST_BYTES, observed, one_list, refuse_mixture
from goniotwin.app.formats.metadata import (
    InstrumentMetadata,
    Metadata,
    ReceiverMetadata,
    SampleMetadata,
    SourceMetadata,
    metadata_from_dict,
)
from goniotwin.app.formats.text import comment_lines, read_text, write_text
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import round_deg, wrap_azimuth

TITLE = "BiRD file"
SCHEMA = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"
NOT_STATED = "NA"
NO_ADDRESS = "not-stated@example.invalid"
OWN = "goniotwin"
"""Name of this program's entry in `adhoc_section`."""
PER_SR = ("1/sr", "sr^-1", "sr-1", "sr^{-1}")
DEGREES, RADIANS = ("deg", "°", "degree", "degrees"), ("rad", "radian", "radians")
NANOMETRES, MICROMETRES = ("nm",), ("um", "μm", "µm")
MOST_LISTS = 5_000_000
ABOUT_U = "standard uncertainty (k = 1)"
STOKES = {"1 0 0 0": "u", "1 1 0 0": "s", "1 -1 0 0": "p"}
"""States of polarisation by their Stokes vectors: s is (1, 1, 0, 0), as the schema has it."""


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is JSON with the names of this format."""
    begins = head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{")
    return begins and b'"BRDF"' in head and (b'"metadata"' in head or b'"theta_i"' in head)


# ---- reading ----


def read(path: Path) -> BsdfFile:
    """Read a file: one part, or one for each state of polarisation. Raises FormatError."""
    document = _json(path)
    metadata, data = (document.get(name) if isinstance(document, dict) else None for name in ("metadata", "data"))
    if not isinstance(data, dict):
        raise FormatError(path, 'it has no object "data"', "give a file of the BiRD format")
    with name_file(path):
        return _Reader(path, metadata if isinstance(metadata, dict) else {}, data).content()


def _json(path: StrPath) -> Any:
    text = read_text(path, MOST_BYTES)
    if text.count("[") + text.count("{") > MOST_LISTS:
        raise FormatError(path, f"has more than {MOST_LISTS} lists", "it is damaged, or not of this format")
    try:
        return json.loads(text, parse_constant=_constant)
    except json.JSONDecodeError as error:
        raise FormatError(path, f"not JSON: {error.msg}", "it is cut short or damaged: copy it again", error.lineno) from None
    except ValueError as error:
        raise FormatError(path, f"not JSON of this format: {error}", "correct it") from None
    except RecursionError:
        raise FormatError(path, "has lists in lists without end", "it is damaged: copy it again") from None


def _constant(word: str) -> float:
    if word != "NaN":
        raise ValueError(f"{word} is not a finite number")
    return float("nan")


@dataclass
class _Reader:
    path: StrPath
    metadata: Mapping[str, Any]
    data: Mapping[str, Any]
    size: int = 0

    def content(self) -> BsdfFile:
        """What the file holds. Raises FormatError and ValueError."""
        if "variables" in self.data:
            self.data = self._older_layout()
        values = self._numbers("BRDF", dict.fromkeys(PER_SR, 1.0))
        self.size = values.size
        if not self.size:
            raise FormatError(self.path, "it has no values", "it is cut short: copy it again")
        sigma, psi, theta, phi = (self._angles(name) for name in ("theta_i", "phi_i", "theta_r", "phi_r"))
        polar, azimuth = observed(theta, phi)
        own = self._own()
        stated = self.metadata.get("comments")
        comments = [line for line in comment_lines([stated] if isinstance(stated, str) else [], ascii_only=False) if line]
        u, about_u = self._u(values)
        found = ScatteredBsdf(
            self._polar("theta_i", sigma),
            wrap_azimuth(psi),
            self._polar("theta_r", polar),
            azimuth,
            values,
            u,
            wavelength_nm=self._wavelengths(),
            back=np.full(self.size, own.get("lit_on_the_back") is True),
            generated=self.metadata.get("method") == "simulation",
            sample=self._sample(own),
            isotropic=self._isotropic(psi),
            **self._own_columns(),
        )
        states = self._polarisations()
        parts = [replace(found, comments=(*comments, *about_u, *self._left_out()))]
        if len(names := list(dict.fromkeys(states))) > 1:
            chosen = np.array(states, dtype=np.str_)
            parts = [
                replace(parts[0].where(chosen == name), sample=f"{found.sample}, polarisation {name}".removeprefix(", "))
                for name in names
            ]
        metadata = self._metadata(own)
        if len(names) == 1 and names[0] and not metadata.source.polarisation:
            metadata = replace(metadata, source=replace(metadata.source, polarisation=names[0]))
        return BsdfFile(tuple(parts), metadata)

    def _older_layout(self) -> dict[str, Any]:
        """The columns of a file with a list of variables and rows of values."""
        variables, rows = self.data.get("variables"), self.data.get("values")
        if not isinstance(variables, list) or not isinstance(rows, list) or not all(isinstance(v, dict) for v in variables):
            raise FormatError(self.path, '"variables" and "values" of its data are not lists', "correct the file")
        odd = next((k for k, row in enumerate(rows) if not isinstance(row, list) or len(row) != len(variables)), None)
        if odd is not None:
            raise FormatError(self.path, f"row {odd + 1} has not {len(variables)} values", "give one of each variable")
        columns = zip(*rows, strict=True) if rows else ((),) * len(variables)
        return {
            str(variable.get("name")): {**variable, "values": list(column)}
            for variable, column in zip(variables, columns, strict=True)
        }

    def _column(self, name: str) -> Mapping[str, Any]:
        column = self.data.get(name)
        if not isinstance(column, dict) or not isinstance(column.get("values"), list):
            raise FormatError(self.path, f"the column {name} is missing, or has no list of values", "correct the file")
        return column

    def _numbers(self, name: str, units: Mapping[str, float], missing: bool = True) -> Floats:
        """The values of a column, times the factor of its unit. Raises FormatError."""
        column = self._column(name)
        unit = str(column.get("unit", "")).strip().lower()
        if unit not in units:
            raise FormatError(self.path, f"{name} has the unit {quote_word(unit)}", f"give {' or '.join(units)}")
        values = [np.nan if each is None else each for each in column["values"]]
        if not all(type(each) in (float, int) for each in values):
            odd = next(k for k, each in enumerate(values) if type(each) not in (float, int))
            raise FormatError(self.path, f"{name} has at place {odd + 1} what is no number", "correct it")
        try:
            found = np.array(values, dtype=np.float64) * units[unit]
        except OverflowError:
            found = np.array([np.inf])
        if np.isinf(found).any() or (np.isnan(found).any() and not missing):
            raise FormatError(self.path, f"{name} has values that are not finite", "correct them")
        return self._of_size(name, found)

    def _of_size(self, name: str, found: npt.NDArray[Any]) -> npt.NDArray[Any]:
        if name != "BRDF" and len(found) != self.size:
            wrong = f"{name} has {len(found)} values, and BRDF has {self.size}"
            raise FormatError(self.path, wrong, "it is damaged: give one value of each column for each direction")
        return found

    def _angles(self, name: str) -> Floats:
        degrees = {**dict.fromkeys(DEGREES, 1.0), **dict.fromkeys(RADIANS, 180.0 / np.pi)}
        found = self._numbers(name, degrees, missing=False)
        return found if np.array_equal(found, plain := round_deg(found)) else np.where(abs(found - plain) < 1e-9, plain, found)

    def _polar(self, name: str, found: Floats) -> Floats:
        odd = np.flatnonzero(~((found >= 0.0) & (found <= 90.0 + BEYOND_DEG)))
        if odd.size:
            wrong = f"{name} has at place {odd[0] + 1} {found[odd[0]]:g} deg"
            raise FormatError(self.path, wrong, "a BRDF has polar angles of 0 to 90 deg: correct it")
        return np.minimum(found, 90.0)

    def _wavelengths(self) -> Floats:
        units = {**dict.fromkeys(NANOMETRES, 1.0), **dict.fromkeys(MICROMETRES, 1000.0)}
        names = [name for name in ("wavelength_i", "wavelength_r") if name in self.data]
        found = [self._numbers(name, units, missing=False) for name in names]
        if len(found) == 2 and not np.allclose(found[0], found[1]):
            wrong = "wavelength_r is not wavelength_i: light of another wavelength is no part of a BRDF here"
            raise FormatError(self.path, wrong, "leave fluorescence out")
        return round_deg(found[0]) if found else ABSENT

    def _u(self, values: Floats) -> tuple[Floats, list[str]]:
        """Standard uncertainties, and a comment on what is not stated about them."""
        about = []
        if "uBRDF" in self.data:
            unit = str(self._column("uBRDF").get("unit", "")).strip()
            factors = {**dict.fromkeys(PER_SR, 1.0), "%": 0.01}
            u = self._numbers("uBRDF", factors) * (np.abs(values) if unit == "%" else 1.0)
            about = [] if "k = 1" in str(self._column("uBRDF").get("comments", "")) else ["uBRDF"]
        else:
            constant = self._column("BRDF").get("uncertainty")
            value, of = (_at(constant, name) for name in ("value", "unit"))
            if type(value) not in (float, int) or of not in (*PER_SR, "%"):
                return ABSENT, []
            u = 0.01 * float(value) * np.abs(values) if of == "%" else np.full(values.size, float(value))
            about = ["the uncertainty of BRDF"]
        if (u < 0.0).any():
            raise FormatError(self.path, "uBRDF has negative values", "correct them")
        return u, [f"the coverage factor of {name} is not stated: read as standard uncertainties" for name in about]

    def _own(self) -> Mapping[str, Any]:
        section = self.metadata.get("adhoc_section")
        own = section.get(OWN) if isinstance(section, dict) else None
        return own if isinstance(own, dict) else {}

    def _own_columns(self) -> dict[str, Any]:
        """The columns that only this program writes."""
        found: dict[str, Any] = {}
        columns = self.data.get("adhoc_variables")
        for name, kinds, dtype in (
            ("flags", (str,), np.str_),
            ("photodiode", (int,), np.int64),
            ("u_shared", (int, float), np.float64),
            ("low95", (int, float), np.float64),
            ("high95", (int, float), np.float64),
            ("interval", (str,), np.str_),
        ):
            column = columns.get(f"{OWN}_{name}") if isinstance(columns, dict) else None
            values = column.get("values") if isinstance(column, dict) else None
            if isinstance(values, list) and all(type(each) in kinds for each in values):
                found[name] = self._of_size(name, np.array(values, dtype=dtype))
        return found

    def _left_out(self) -> list[str]:
        known = {"theta_i", "phi_i", "theta_r", "phi_r", "BRDF", "uBRDF", "wavelength_i", "wavelength_r", "polarization_i"}
        adhoc = self.data.get("adhoc_variables")
        others = [name for name in (adhoc if isinstance(adhoc, dict) else ()) if not str(name).startswith(f"{OWN}_")]
        others += [name for name in self.data if name not in {*known, "polarization_r", "adhoc_variables"}]
        return [f"columns that are not read: {', '.join(map(quote_word, others[:20]))}"] if others else []

    def _polarisations(self) -> list[str]:
        """The state of polarisation of each value, empty where none is stated."""
        states = [""] * self.size
        for name, of in (("polarization_i", ""), ("polarization_r", "observed ")):
            if name in self.data:
                found = self._of_size(name, np.array([_state(each) for each in self._column(name)["values"]], dtype=np.str_))
                states = [f"{before} {of}{state}".strip() for before, state in zip(states, found.tolist(), strict=True)]
        return states

    def _sample(self, own: Mapping[str, Any]) -> str:
        sample = self.metadata.get("sample")
        name = own.get("sample", sample.get("name", "") if isinstance(sample, dict) else sample)
        return "" if not isinstance(name, str) or name == NOT_STATED else printable(name)

    def _isotropic(self, psi: Floats) -> bool:
        sample = self.metadata.get("sample")
        words = str(sample.get("properties_symmetry", "")).lower() if isinstance(sample, dict) else ""
        return "anisotropic" not in words if "isotropic" in words else np.unique(psi).size == 1

    def _metadata(self, own: Mapping[str, Any]) -> Metadata:
        """The metadata: this program's own, or what BiRD's fields state."""
        if isinstance(own.get("metadata"), dict):
            return metadata_from_dict(own["metadata"])
        text = _texts(self.metadata)
        lamp = "instrumentation", "illumination_system"
        angle = _at(self.metadata, "instrumentation", "detection_system", "solid_angle", "value")
        return Metadata(
            title=text("description"),
            date=text("timestamp"),
            operator=text("instrumentation", "operator_name"),
            laboratory=text("provenance", "organization"),
            licence=text("license", "type"),
            environment=text("environment"),
            sample=SampleMetadata(
                text("sample", "name"),
                text("sample", "manufacturer"),
                text("sample", "type"),
                "",
                text("sample", "zero_azimuth_location"),
                text("sample", "treatment"),
            ),
            instrument=InstrumentMetadata(text("instrumentation", "name"), text("software", "name")),
            source=SourceMetadata(text(*lamp, "source", "name") or text(*lamp, "name")),
            receiver=ReceiverMetadata(
                text("instrumentation", "detection_system", "name"),
                float(angle) if isinstance(angle, float | int) else None,
            ),
        )


def _state(value: Any) -> str:
    """A state of polarisation in a word: s, p, u, or its Stokes vector."""
    vector = " ".join(f"{each:g}" for each in value if isinstance(each, float | int)) if isinstance(value, list) else None
    return printable(str(value)[:40]) if vector is None else STOKES.get(vector, f"({vector[:60]})")


def _at(entries: Any, *names: str) -> Any:
    for name in names:
        entries = entries.get(name) if isinstance(entries, dict) else None
    return entries


def _texts(entries: Mapping[str, Any]) -> Callable[..., str]:
    """The text at a place; of an object, its own entries in words; empty where nothing is stated."""

    def text(*names: str) -> str:
        found = _at(entries, *names)
        if isinstance(found, dict):
            found = "; ".join(f"{name} {_in_words(each)}" for name, each in found.items())
        return printable(found) if isinstance(found, str) and found not in (NOT_STATED, NO_ADDRESS) else ""

    return text


def _in_words(entry: Any) -> str:
    if isinstance(entry, dict):
        return " ".join(str(entry[name]) for name in ("value", "unit") if name in entry)
    return str(entry)


# ---- writing ----


def write(path: Path, content: BsdfFile) -> None:
    """Write the values of one sample and side; directions without a value are not written. Raises FormatError."""
    values = one_list(path, content, f"a {TITLE}")
    if values.transmitted.any():
        raise FormatError(path, f"a {TITLE} holds reflected light, and some is transmitted", "write it in another format")
    if (values.channel != "").any():
        raise FormatError(path, f"a {TITLE} holds wavelengths, and these values are of colours", "write another format")
    back = refuse_mixture(path, f"a {TITLE}", values.back, "light on the front", "light on the back")
    measured = values.where(np.isfinite(values.values))
    if not measured.size:
        raise FormatError(path, "there is no value to write", "write values that were measured")
    columns = [f'"{name}": {column_text}' for name, column_text in _columns(path, measured)]
    without = values.size - measured.size
    notes = [f"{without} directions without a value are not written"] if without else []
    digest = hashlib.sha256()
    for each in columns:
        digest.update(each.encode())
    about = _about(content, measured, notes, str(uuid.uuid5(uuid.NAMESPACE_URL, digest.hexdigest())), back)
    head = json.dumps(about, indent=1, ensure_ascii=False)
    write_text(path, _document(head, columns))


def _document(head: str, columns: Sequence[str]) -> Iterator[str]:
    yield f'{{\n"metadata": {head},\n"data": {{\n'
    for k, each in enumerate(columns):
        yield each + (",\n" if k + 1 < len(columns) else "\n}\n}\n")


def _columns(path: StrPath, values: ScatteredBsdf) -> Iterator[tuple[str, str]]:
    for name, angles in (
        ("theta_i", values.sigma_deg),
        ("phi_i", values.psi_deg),
        ("theta_r", values.polar_deg),
        ("phi_r", values.azimuth_deg),
    ):
        yield name, _spelled("deg", wrap_azimuth(round_deg(angles)) if name.startswith("phi") else angles)
    negative, grazing = int((values.values < 0.0).sum()), int(((values.sigma_deg >= 90.0) | (values.polar_deg >= 90.0)).sum())
    notes = [f"{negative} values are below 0, as measured"] if negative else []
    notes += [f"{grazing} directions are at 90 deg"] if grazing else []
    yield "BRDF", _spelled("sr^-1", values.values, "; ".join(notes))
    unknown = np.isnan(values.u)
    if not unknown.all():
        note = f"; {unknown.sum()} are unknown, and are the value itself" if unknown.any() else ""
        yield "uBRDF", _spelled("sr^-1", np.where(unknown, np.abs(values.values), values.u), ABOUT_U + note)
    if np.isfinite(values.wavelength_nm).all():
        yield "wavelength_i", _spelled("nm", values.wavelength_nm)
    elif np.isfinite(values.wavelength_nm).any():
        raise FormatError(path, f"a {TITLE} has no room for grey and spectral values", "write them in two files")
    if own := ",\n".join(_own_columns(values)):
        yield "adhoc_variables", f"{{{own}}}"


def _spelled(unit: str, numbers: Floats, comments: str = "") -> str:
    note = f', "comments": {json.dumps(comments)}' if comments else ""
    return f'{{"unit": "{unit}"{note}, "values": [{_numbers(numbers)}]}}'


def _numbers(numbers: Floats) -> str:
    return ", ".join(map("%.9g".__mod__, numbers.tolist()))


def _own_columns(values: ScatteredBsdf) -> Iterator[str]:
    """Columns that BiRD has no name for, where they differ from what is meant without them."""
    stated = bool((values.interval != "").all())  # there is no number for one that is not
    columns: Iterable[tuple[str, str, str, bool, Callable[[], str]]] = (
        (
            "u_shared",
            "part of uBRDF that neighbouring values share",
            "number",
            bool((values.u_shared != 0.0).any()),
            lambda: _numbers(values.u_shared),
        ),
        ("low95", "lower end of the interval of 95 %", "number", stated, lambda: _numbers(values.low95)),
        ("high95", "upper end of the interval of 95 %", "number", stated, lambda: _numbers(values.high95)),
        (
            "interval",
            "law of the interval of 95 %",
            "string",
            stated,
            lambda: json.dumps(values.interval.tolist())[1:-1],
        ),
        (
            "flags",
            "flags of each value, words between blanks",
            "string",
            bool((values.flags != "").any()),
            lambda: json.dumps(values.flags.tolist())[1:-1],
        ),
        (
            "photodiode",
            "number of the photodiode",
            "integer",
            bool((values.photodiode >= 0).any()),
            lambda: json.dumps(values.photodiode.tolist())[1:-1],
        ),
    )
    for name, what, kind, there, spelled in columns:
        if there:
            unit = "sr^-1" if kind == "number" else ""
            head = json.dumps({"description": what, "unit": unit, "type": kind})[:-1]
            yield f'"{OWN}_{name}": {head}, "values": [{spelled()}]}}'


def _about(content: BsdfFile, values: ScatteredBsdf, notes: Sequence[str], identifier: str, back: bool) -> dict[str, Any]:
    """The object `metadata`, with all that the schema requires."""
    known = content.metadata
    simulated = values.generated
    own: dict[str, Any] = {"sample": values.sample, "lit_on_the_back": back, "metadata": known.as_dict()}
    angle = known.receiver.solid_angle_sr
    instrument = {
        "name": known.instrument.name or NOT_STATED,
        "operator_name": known.operator or NOT_STATED,
        "illumination_system": {"name": known.source.description or NOT_STATED},
        "detection_system": {
            "name": known.receiver.description or NOT_STATED,
            **({} if angle is None else {"solid_angle": {"value": angle, "unit": "sr"}}),
        },
    }
    place = dict.fromkeys(("country", "city", "street", "building_nr", "postal_code"), NOT_STATED)
    comments = comment_lines((*notes, *content.comments, *values.comments), ascii_only=False)
    return {
        "schema": SCHEMA,
        "id": f"urn:uuid:{identifier}",
        "type": "BRDF",
        "timestamp": known.date or NOT_STATED,
        "provenance": {
            "organization": known.laboratory or NOT_STATED,
            "location": place,
            "email": NO_ADDRESS,
            "contact_person": known.operator or NOT_STATED,
        },
        **({"license": {"type": known.licence, "rights_holder": known.laboratory or NOT_STATED}} if known.licence else {}),
        **({"description": known.title} if known.title else {}),
        "method": "simulation" if simulated else "measurement",
        "instrumentation": NOT_STATED if simulated else instrument,
        "software": {"name": known.instrument.software or NOT_STATED},
        "sample": {
            "name": values.sample or known.sample.identifier or NOT_STATED,
            "type": known.sample.description or NOT_STATED,
            "shape": NOT_STATED,
            "dimensions": {},
            "zero_azimuth_location": known.sample.azimuth_mark or NOT_STATED,
            "properties_symmetry": "isotropic" if values.isotropic else "anisotropic",
            **({"manufacturer": known.sample.maker} if known.sample.maker else {}),
            **({"treatment": known.sample.preparation} if known.sample.preparation else {}),
        },
        "environment": NOT_STATED,
        **({"comments": "\n".join(comments)} if comments else {}),
        "adhoc_section": {OWN: own},
    }
