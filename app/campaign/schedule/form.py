"""The form of a schedule: the fields that an operator fills in first, each one key of the file, with its value as text.

A field's help, choices and default are those of the key. In a field a list is `30, 60`, a range `0 to 350 step 10`, and both
may be mixed; what begins with a bracket is TOML. A number keeps the form in which it is typed.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Item

from goniotwin.app.campaign.schedule.editing import literal, remove_value, set_value
from goniotwin.app.campaign.schedule.file import ScheduleFile, parse_schedule
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.campaign.wording import key_text
from goniotwin.app.errors import UserError
from goniotwin.app.toml_file import json_schema, parse_toml
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG

NUMBER = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
ONE_OR_TWO = re.compile(r"([-+]?\d+),(\d+)")
"""A comma without a blank: a decimal comma, or between two numbers."""
RANGE = re.compile(rf"({NUMBER})\s+to\s+({NUMBER})\s+step\s+({NUMBER})")


@dataclass(frozen=True)
class FormField:
    """A field of the form: the dotted path of its key, and its label."""

    key: str
    label: str

    @property
    def path(self) -> tuple[str, ...]:
        """The key's path."""
        return tuple(self.key.split("."))

    @property
    def help(self) -> str:
        """What the key means."""
        return str(self._schema["description"])

    @property
    def choices(self) -> tuple[str, ...]:
        """The words that the key can have; none where it has others too."""
        return tuple(self._schema.get("enum", ()))

    def shown(self, text: str, name: str) -> str:
        """The field's text for the text of a schedule; that of the default where there is no such key. Raises UserError."""
        parse_toml(text, name)
        here: Any = tomlkit.parse(text)
        for part in self.path:
            here = here.get(part) if isinstance(here, Mapping) else None
        return _shown(self._schema.get("default", "") if here is None else here)

    def edited(self, text: str, typed: str, name: str) -> str:
        """The text of a schedule with what was typed into the field; nothing removes the key. Raises UserError.

        A field as it is shown changes nothing. A table that needs the key is removed with it. Drift checks that are added are
        at the first sigma, at the specular direction or the last beta.
        """
        typed = typed.strip()
        if typed == self.shown(text, name):
            return text
        *tables, last = self.path
        if not typed:
            required = tables and last in _schema_of(tuple(tables)).get("required", ())
            return remove_value(text, tuple(tables) if required else self.path, name)
        edited = set_value(text, self.path, self.value(typed), name)
        if tables == ["drift"] and "drift" not in parse_toml(text, name):
            file = parse_schedule(text, name).file
            betas, wavelengths = grid_values(file.beta_deg), sorted(grid_values(file.wavelength_nm))
            beta = SPECULAR_AZIMUTH_DEG if SPECULAR_AZIMUTH_DEG in betas else betas[-1]
            pose = {"sigma_deg": grid_values(file.sigma_deg)[0], "beta_deg": beta}
            for key, value in {**pose, "wavelength_nm": wavelengths[len(wavelengths) // 2]}.items():
                edited = set_value(edited, ("drift", key), value, name)
        return edited

    def value(self, typed: str) -> Item:
        """What was typed, as a value of TOML. Raises UserError."""
        try:
            return tomlkit.value(self._literal(typed))
        except (TOMLKitError, ValueError):
            raise UserError(f"{self.label}: {typed!r} is {self._expected}") from None

    def _literal(self, typed: str) -> str:
        schema = self._schema
        words = [*self.choices, *(each["const"] for each in schema.get("oneOf", ()) if "const" in each)]
        if schema.get("type") == "string" or typed in words:
            return literal(typed)
        if typed[0] in "[{":
            return typed
        if schema.get("type") in ("number", "integer"):
            return _number(typed)
        if (found := ONE_OR_TWO.fullmatch(typed)) is not None:
            one, two = (mark.join(found.groups()) for mark in (".", ", "))
            raise UserError(f"{self.label}: {typed!r} may be one number or two; write {one} or {two}")
        parts = [part.strip() for part in typed.split(",")]
        if schema.get("type") == "array":
            return literal(parts)
        ranges = [RANGE.fullmatch(part) for part in parts]
        values = [
            _number(part) if found is None else "{{ start = {}, stop = {}, step = {} }}".format(*map(_number, found.groups()))
            for part, found in zip(parts, ranges, strict=True)
        ]
        return values[0] if len(values) == 1 and ranges[0] is not None else f"[{', '.join(values)}]"

    @property
    def _expected(self) -> str:
        if self._schema.get("type") in ("number", "integer"):
            return "no number; write one such as 0.01 or 1e10"
        return "neither numbers nor a range; write 30, 60 or 0 to 350 step 10"

    @property
    def _schema(self) -> Any:
        return _schema_of(self.path)


FIELDS = (
    FormField("name", "Name"),
    FormField("samples", "Samples"),
    FormField("etalon", "Reference standard"),
    FormField("side", "Lit side"),
    FormField("symmetry", "Symmetry"),
    FormField("sigma_deg", "Sigma (incidence), deg"),
    FormField("gamma_deg", "Gamma (sample), deg"),
    FormField("beta_deg", "Beta (arc), deg"),
    FormField("shift_deg", "Shift of the arc, deg"),
    FormField("wavelength_nm", "Wavelengths, nm"),
    FormField("gains_v_per_a", "Gains, V/A"),
    FormField("readings", "Readings"),
    FormField("target.relative_u", "Target u (k = 1), relative"),
    FormField("target.longest_h", "Longest time, h"),
    FormField("drift.every_s", "Drift check every, s"),
)
"""In the order of the form."""

SAMPLE_FIELDS = tuple(
    FormField(f"metadata.samples.NAME.{key}", key_text(key).capitalize())
    for key in SampleMetadataTable.model_fields
    if key not in ("picture_sha256", "mounted_at")
)
"""What a person states of a sample; digest and time are found."""


def _number(typed: str) -> str:
    """A number as typed. Raises ValueError for anything else."""
    if re.fullmatch(NUMBER, typed) is None:
        raise ValueError(typed)
    return typed


def _shown(value: Any) -> str:
    """A value as the text of a field."""
    if isinstance(value, Mapping):
        keys = ("start", "stop", "step")
        return "{} to {} step {}".format(*(literal(value[key]) for key in keys)) if {*value} == {*keys} else literal(value)
    if isinstance(value, str):
        return str(value)
    return ", ".join(map(_shown, value)) if isinstance(value, Sequence) else literal(value)


@cache
def _file_schema() -> dict[str, Any]:
    return json_schema(ScheduleFile, "schedule")


def _schema_of(path: tuple[str, ...]) -> Any:
    """The JSON Schema of a key, or of a table, with its description."""
    schema = _file_schema()
    here: Any = schema
    for part in path:
        here = here["properties"][part] if "properties" in here else here["additionalProperties"]
        if "$ref" in here:
            here = schema["$defs"][here["$ref"].rpartition("/")[2]]
    return here
