"""The hash of a virtual rig's model: it covers everything that decides the behaviour of the virtual rig.

Version 2, `model_hash`, is of a text with the names and values of fields, without names of classes and modules, so that these
can change. A hash begins with the version of its text. A model that does not use a later field keeps its hash.

Version 1, `old_model_hash`, has no such prefix. It is of the `repr` of the model's parts, with the names of classes at that
time. Older journals and rig files of older served rigs identify a model by it. These names and the order of the fields are
frozen here and must not follow later changes of the classes.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from enum import Enum
from numbers import Integral, Real
from typing import Any

import numpy as np

from goniotwin.twin import TwinModel

VERSION = 2
LATER_MAPPINGS = ("devices", "diattenuation")
"""Later fields of a model, which keeps its hash where they are empty."""


def model_hash(model: TwinModel) -> str:
    """The hash of a model, with the tables of its samples, but without the seed and the names of the samples."""
    known = [
        each for each in fields(model) if each.name not in ("seed", *LATER_MAPPINGS) and not _is_later_default(each, model)
    ]
    parts = {entry.name: getattr(model, entry.name) for entry in known}
    parts |= {name: getattr(model, name) for name in LATER_MAPPINGS if getattr(model, name)}
    parts["samples"] = {
        key: {entry.name: getattr(sample, entry.name) for entry in fields(sample) if entry.name != "name"}
        for key, sample in model.samples.items()
    }
    return f"{VERSION}:{hashlib.sha256(canonical_text(parts).encode()).hexdigest()[:16]}"


def model_hashes(model: TwinModel) -> tuple[str, ...]:
    """All hashes that identify a model in journals and rig files: the present version first, then the older one."""
    old = old_model_hash(model)
    return (model_hash(model),) if old is None else (model_hash(model), old)


def canonical_text(value: object) -> str:
    """A text that is the same for equal values.

    Dataclasses and mappings are written by the names of their fields, in alphabetical order, lists and tuples alike, 1 as 1.0,
    an enum as its value, an array as its shape, type and the SHA-256 of its bytes. A field of a dataclass that was added
    `LATER` is omitted at its default. Raises TypeError for anything else, such as a function, because two of them cannot be
    compared.
    """
    if value is None:
        return "null"
    if isinstance(value, Enum):
        return canonical_text(value.value)
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(str(value))
    if isinstance(value, Real):
        return _number(value)
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(canonical_text, value))}]"
    if is_dataclass(value) and not isinstance(value, type):
        value = {entry.name: getattr(value, entry.name) for entry in fields(value) if not _is_later_default(entry, value)}
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{json.dumps(str(key))}: {canonical_text(value[key])}' for key in sorted(value))}}}"
    raise TypeError(f"a {type(value).__name__} has no canonical text: give numbers, texts, arrays of numbers or dataclasses")


def _is_later_default(entry: Field[Any], owner: Any) -> bool:
    return "later" in entry.metadata and _is_default(entry, owner)


def _is_default(entry: Field[Any], owner: Any) -> bool:
    """Whether a field is at its default, whatever the classes are called."""
    default = entry.default if entry.default_factory is MISSING else entry.default_factory()
    value = getattr(owner, entry.name)
    if is_dataclass(default) and is_dataclass(value):  # the value may have further fields, with defaults of their own
        texts = [[canonical_text(getattr(one, each.name, None)) for each in fields(default)] for one in (default, value)]
        further = [each for each in fields(value) if not hasattr(default, each.name)]
        return texts[0] == texts[1] and all(_is_default(each, value) for each in further)
    return default is not MISSING and canonical_text(value) == canonical_text(default)


def _number(value: Real) -> str:
    number = float(value)
    if isinstance(value, Integral) and int(value) != number:
        return repr(int(value))
    return repr(number + 0.0)  # -0.0 is 0.0


def _array(values: np.ndarray) -> str:
    if values.dtype.kind not in "biuf":
        raise TypeError(f"an array of the type {values.dtype} has no canonical text: give an array of numbers")
    plain = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    return f"array {values.shape} {plain.dtype.str} {hashlib.sha256(plain.tobytes()).hexdigest()}"


@dataclass(frozen=True)
class Former:
    """A class in version 1: its name, its fields in order, and the classes of the values of fields, by field."""

    name: str
    fields: tuple[str, ...]
    of: Mapping[str, "Former"]


def _former(name: str, names: str, **of: Former) -> Former:
    return Former(name, tuple(names.split()), of)


_WHEEL_FILTER = _former("WheelFilter", "position cut_on_nm transmittance")
_DEVIATION = _former("Deviation", "rx_deg ry_deg rz_deg x_mm y_mm z_mm")
_SENSOR = _former("RealSensor", "lens_diameter_mm focal_length_mm aperture_mm diaphragm_mm detector_mm detector_side_mm")
_PARTS = {
    "axes": _former(
        "Mechanics",
        "motor gear sense zero_deg full_steps encoder module backlash_deg lower_switch_deg upper_switch_deg home_deg "
        "home_width_deg encoder_counts encoder_error_deg",
    ),
    "instrument": _former(
        "Instrument",
        "pupil_radius_mm pupil_to_mirror_mm mirror_distance_mm mirror_side_mm mirror_mount_mm mirror_reflectance spot_side_mm "
        "arc_radius_mm detector_diameter_mm field_deg obstruction deviations sensor",
        deviations=_DEVIATION,
        sensor=_SENSOR,
    ),
    "frames": _former("SampleFrames", "gap_mm side_mm reflectance lit"),
    "light": _former(
        "Light",
        "radiance band_nm throughput spectrum drift_per_hour flicker flicker_period_s wander wander_period_s",
    ),
    "photodiodes": _former(
        "Photodiodes",
        "upper_deg lower_deg responsivity dark_a dark_spread dark_wander dark_wander_period_s",
    ),
    "electronics": _former(
        "Electronics",
        "gains_v_per_a gain_spread offset_v noise_v settling_s temperature_k conversions_per_s latency_s module baudrate",
    ),
    "monitor": _former("Monitor", "current_a dark_a noise samples_per_s serial_number latency_s"),
    "monochromator": _former(
        "MonochromatorDrive",
        "slew_nm_per_s settle_s shutter_s filter_s start_nm echo baudrate handshake grating_s slit_um_per_s nm_per_step "
        "gratings filters already_there_is_error",
    ),
    "controller": _former("AxisController", "kind wire baudrate latency_s encoder_noise_microsteps"),
    "estimator": _former("Estimator", "kind rays relative_error stray"),
    "order_sorting": _former("OrderSorting", "second_order filters", filters=_WHEEL_FILTER),
}
_MODEL = ("seed", "samples", "noise", *_PARTS)
_SAMPLE = ("name", "lobes", "spectrum")
_SPECTRUM = ("wavelengths_nm", "weights")
_LOBE = ("kind", "params", "sigma_deg", "phi_deg", "theta_deg", "psi_deg", "values", "incident", "transmits")


class _Unknown(Exception):
    """The model has a value that version 1 cannot represent."""


def old_model_hash(model: TwinModel) -> str | None:
    """The hash of a model in version 1.

    None for a model that was not possible then: a later field is not at its default, or a value is of another kind. No older
    journal can have such a model.
    """
    try:
        return _digest(model)
    except _Unknown:
        return None


def _digest(model: TwinModel) -> str:
    if any(getattr(model, name) for name in LATER_MAPPINGS):
        raise _Unknown
    _refuse_later_fields(model, (*_MODEL, *LATER_MAPPINGS))
    digest = hashlib.sha256()
    text = {name: _text(getattr(model, name), former) for name, former in _PARTS.items()}
    for name in ("axes", "instrument", "frames", "light", "photodiodes", "electronics", "monitor"):
        digest.update(text[name].encode())
    digest.update(f"({text['monochromator']}, {text['controller']}, {bool(model.noise)}, {text['estimator']})".encode())
    if model.order_sorting.second_order or model.order_sorting.filters:
        digest.update(text["order_sorting"].encode())
    for key, sample in sorted(model.samples.items()):
        _refuse_later_fields(sample, _SAMPLE)
        digest.update(f"{key} {len(sample.lobes)} {sample.spectrum is None}".encode())
        if sample.spectrum is not None:
            _refuse_later_fields(sample.spectrum, _SPECTRUM)
            digest.update(sample.spectrum.wavelengths_nm.tobytes() + sample.spectrum.weights.tobytes())
        for lobe in sample.lobes:
            _refuse_later_fields(lobe, _LOBE)
            digest.update(f"{int(lobe.kind)} {int(lobe.incident)} {bool(lobe.transmits)} {lobe.values.shape}".encode())
            for values in (lobe.params, lobe.sigma_deg, lobe.phi_deg, lobe.theta_deg, lobe.psi_deg, lobe.values):
                digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


def _text(value: Any, former: Former | None) -> str:
    """The `repr` in version 1 of a value of the class `former`, or of a collection of such values."""
    if value is None:
        return "None"
    if isinstance(value, tuple):
        entries = [_text(each, former) for each in value]
        return f"({entries[0]},)" if len(entries) == 1 else f"({', '.join(entries)})"
    if isinstance(value, Mapping):
        text = "{" + ", ".join(f"{str(key)!r}: {_text(each, former)}" for key, each in value.items()) + "}"
        return text if isinstance(value, dict) else f"mappingproxy({text})"
    if former is None:
        return _plain(value)
    _refuse_later_fields(value, former.fields)
    entries = [f"{name}={_text(getattr(value, name), former.of.get(name))}" for name in former.fields]
    return f"{former.name}({', '.join(entries)})"


def _plain(value: object) -> str:
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return repr(kind(value))
    raise _Unknown


def _refuse_later_fields(value: Any, known: tuple[str, ...]) -> None:
    """Raise _Unknown if `value` is not a dataclass, or a field that is not `known` is not at its default."""
    if not is_dataclass(value):
        raise _Unknown
    for entry in fields(value):
        if entry.name not in known and not _is_default(entry, value):
            raise _Unknown
