"""What is known about a measurement besides its values: the metadata that archives carry, in groups.

The names follow BiRD (https://github.com/BiRD-project) and ASTM E2387, section "report". Texts are the laboratory's own words;
an empty text, None or an empty list: not stated.
"""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields
from typing import Any


@dataclass(frozen=True)
class SampleMetadata:
    """The sample. `side` that was measured, `azimuth_mark`: what on the sample shows azimuth 0. `picture` is the name of a file
    and `picture_sha256` its digest; `mounted_at` a time, ISO 8601."""

    identifier: str = ""
    maker: str = ""
    description: str = ""
    side: str = ""
    azimuth_mark: str = ""
    preparation: str = ""
    thickness_mm: float | None = None
    note: str = ""
    picture: str = ""
    picture_sha256: str = ""
    mounted_by: str = ""
    mounted_at: str = ""


@dataclass(frozen=True)
class InstrumentMetadata:
    """The goniophotometer, its geometry in mm, and the program with the version that made the values."""

    name: str = ""
    software: str = ""
    arc_radius_mm: float | None = None
    pupil_distance_mm: float | None = None


@dataclass(frozen=True)
class SourceMetadata:
    """The light on the sample: wavelengths and bandwidth (full width at half maximum), polarisation, spot, divergence."""

    description: str = ""
    wavelengths_nm: tuple[float, ...] = ()
    bandwidth_nm: float | None = None
    polarisation: str = ""
    spot_mm: float | None = None
    divergence_deg: float | None = None


@dataclass(frozen=True)
class ReceiverMetadata:
    """The photodiodes: their solid angle, field of view, and the gains that were used."""

    description: str = ""
    solid_angle_sr: float | None = None
    field_of_view_deg: float | None = None
    gains_v_per_a: tuple[float, ...] = ()


@dataclass(frozen=True)
class ReferenceMetadata:
    """The reference standard (etalon) and its certificate."""

    name: str = ""
    certificate: str = ""
    date: str = ""
    relative_uncertainty: float | None = None


@dataclass(frozen=True)
class QualityMetadata:
    """Figures of the campaign: instrument signature, noise floor in 1/sr, drift of the lamp, repeats; findings in words."""

    signature: str = ""
    noise_floor_per_sr: float | None = None
    drift: str = ""
    repeats: int | None = None
    findings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Metadata:
    """All groups. `date`: ISO 8601, of the first reading. `geometry`: incidences and directions in words. `raw_data`: the
    digest of the journal's checksums."""

    title: str = ""
    date: str = ""
    operator: str = ""
    laboratory: str = ""
    environment: str = ""
    licence: str = ""
    geometry: str = ""
    method: str = ""
    raw_data: str = ""
    sample: SampleMetadata = field(default_factory=SampleMetadata)
    instrument: InstrumentMetadata = field(default_factory=InstrumentMetadata)
    source: SourceMetadata = field(default_factory=SourceMetadata)
    receiver: ReceiverMetadata = field(default_factory=ReceiverMetadata)
    reference: ReferenceMetadata = field(default_factory=ReferenceMetadata)
    quality: QualityMetadata = field(default_factory=QualityMetadata)

    def as_dict(self) -> dict[str, Any]:
        """What is stated, by group, for JSON and archives."""
        return _stated(asdict(self))

    def lines(self) -> list[str]:
        """What is stated, one line each, for comments at the top of a text file."""
        return list(_lines(self.as_dict()))

    def texts(self) -> set[str]:
        """The texts that are stated, without their names."""
        return set(_texts(self.as_dict()))


def _stated(entries: dict[str, Any]) -> dict[str, Any]:
    inner = {name: _stated(each) if isinstance(each, dict) else each for name, each in entries.items()}
    return {
        name: list(each) if isinstance(each, tuple) else each for name, each in inner.items() if each not in ("", None, (), {})
    }


def _texts(entries: Any) -> Iterator[str]:
    if isinstance(entries, dict | list):
        for each in entries.values() if isinstance(entries, dict) else entries:
            yield from _texts(each)
    elif isinstance(entries, str):
        yield entries


def _lines(entries: dict[str, Any], group: str = "") -> list[str]:
    found = []
    for name, each in entries.items():
        if isinstance(each, dict):
            found += _lines(each, f"{name} ")
        else:
            text = ", ".join(
                f"{one:g}" if isinstance(one, float) else str(one) for one in (each if isinstance(each, list) else [each])
            )
            found.append(f"{group}{name.replace('_', ' ')}: {text}")
    return found


def common_metadata(found: Iterable[Metadata]) -> Metadata:
    """What all of these state alike."""
    first, *others = [each.as_dict() for each in found] or [{}]
    for each in others:
        first = _alike(first, each)
    return metadata_from_dict(first)


def _alike(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    both = {name: (each, other[name]) for name, each in one.items() if name in other}
    inner = {name: _alike(*pair) if isinstance(pair[0], dict) else pair[0] for name, pair in both.items()}
    return {name: each for name, each in inner.items() if isinstance(each, dict) or each == other[name]}


def metadata_from_dict(entries: dict[str, Any]) -> Metadata:
    """The metadata of an archive; what has another name or type is not taken."""
    found: Metadata = _from_dict(Metadata, entries)
    return found


def _from_dict(cls: type[Any], entries: dict[str, Any]) -> Any:
    kept: dict[str, Any] = {}
    for each in fields(cls):
        value, default = entries.get(each.name), getattr(cls(), each.name)
        if value is None:
            continue
        if hasattr(default, "__dataclass_fields__"):
            kept[each.name] = _from_dict(type(default), value) if isinstance(value, dict) else default
        elif isinstance(default, str) and isinstance(value, str):
            kept[each.name] = value
        elif isinstance(default, tuple) and isinstance(value, list):
            kept[each.name] = tuple(value)
        elif default is None and isinstance(value, int | float) and not isinstance(value, bool):
            kept[each.name] = value
    return cls(**kept)
