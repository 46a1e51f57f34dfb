"""`[metadata]` of the schedule: what a person states about a campaign. The rest is in rig file and journal."""

import hashlib
import unicodedata
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field

from goniotwin.app.formats.file import read_file
from goniotwin.app.toml_file import Moment, TomlTable, validate_table

LONGEST_TEXT = 1000
LINE_ENDS = ("Cc", "Zl", "Zp")
"""Unicode's categories of control characters and of separators of lines and paragraphs."""


def _check_line(value: str) -> str:
    if any(unicodedata.category(letter) in LINE_ENDS for letter in value):
        raise ValueError("has a line break, a tab or another control character; write it as one line of text")
    return value


Text = Annotated[str, Field(max_length=LONGEST_TEXT), AfterValidator(_check_line)]
"""One line, because it becomes a comment at the top of text files."""


class SampleMetadataTable(TomlTable):
    """`[metadata.samples.NAME]`: what is known about a sample.

    What the operator states as the sample is mounted has priority over this table.

    `identifier`: number or code of the sample. `maker`: manufacturer of the sample. `description`: what the sample is. `side`:
    which side of the sample is lit, in words. `azimuth_mark`: what on the sample shows its azimuth 0. `preparation`: how the
    sample was cleaned, cut and mounted. `thickness_mm`: thickness of the sample. `note`: any remark. `picture`: name of a file
    with a picture of the sample. `picture_sha256`: SHA-256 digest of that file. `mounted_by`: person who mounted the sample.
    `mounted_at`: time of the mounting, with its offset from UTC.
    """

    identifier: Text = ""
    maker: Text = ""
    description: Text = ""
    side: Text = ""
    azimuth_mark: Text = ""
    preparation: Text = ""
    thickness_mm: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    note: Text = ""
    picture: Text = ""
    picture_sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    mounted_by: Text = ""
    mounted_at: Moment = ""

    @property
    def stated(self) -> dict[str, Any]:
        """What is stated, by key."""
        return self.model_dump(exclude_defaults=True)

    @property
    def given(self) -> dict[str, Any]:
        """The keys that are given: an empty text too, which takes the place of an earlier one."""
        return self.model_dump(exclude_unset=True)

    def updated(self, later: Self) -> Self:
        """The record with all that a later one gives."""
        return type(self)(**{**self.given, **later.given})


def sample_record(given: Mapping[str, Any]) -> SampleMetadataTable:
    """The record of a sample as an operator states it; of a picture, its name and the digest of the file at that path.

    Raises UserError, and for a picture that cannot be read FormatError.
    """
    record = validate_table(SampleMetadataTable, dict(given), "sample record")
    if "picture" not in given or record.picture_sha256:
        return record
    digest = hashlib.sha256(read_file(record.picture)).hexdigest() if record.picture else ""
    return record.model_copy(update={"picture": Path(record.picture).name, "picture_sha256": digest})


class MetadataTable(TomlTable):
    """`[metadata]`: what a person states for reports and archives. No value depends on it.

    `title`: title of the report. `operator`: the person who measured. `laboratory`: where the samples were measured.
    `environment`: temperature and humidity during the measurement. `licence`: licence of the data. `instrument`: maker, type
    and serial number of the instrument, beyond the rig file's name. `source`: maker, type and serial number of the light
    source. `receiver`: maker, type and serial number of the detectors. `reference`: the reference standard in words; without it
    its name in the schedule. `certificate`: number of the reference standard's certificate. `samples`: what is known about each
    sample, by its name.
    """

    title: Text = ""
    operator: Text = ""
    laboratory: Text = ""
    environment: Text = ""
    licence: Text = ""
    instrument: Text = ""
    source: Text = ""
    receiver: Text = ""
    reference: Text = ""
    certificate: Text = ""
    samples: dict[Annotated[str, Field(min_length=1)], SampleMetadataTable] = {}
