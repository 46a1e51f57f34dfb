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

    `identifier` is its number or code, `maker` its manufacturer, `description` what it is. `side` names the side that is lit,
    `azimuth_mark` what on the sample shows its azimuth 0, and `preparation` how it was cleaned, cut and mounted.
    `thickness_mm` is its thickness, `note` any remark. `picture` is the name of a file with a picture, and `picture_sha256` the
    digest of that file. `mounted_by` is the person who mounted it, at the time `mounted_at`. What the operator states as the
    sample is mounted has priority over this table.
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

    def updated(self, later: Self) -> Self:
        """The record with all that a later one states."""
        return type(self)(**{**self.stated, **later.stated})


def sample_record(given: Mapping[str, Any]) -> SampleMetadataTable:
    """The record of a sample as an operator states it; of a picture, its name and the digest of the file at that path.

    Raises UserError, and for a picture that cannot be read FormatError.
    """
    record = validate_table(SampleMetadataTable, dict(given), "sample record")
    if not record.picture or record.picture_sha256:
        return record
    digest = hashlib.sha256(read_file(record.picture)).hexdigest()
    return record.model_copy(update={"picture": Path(record.picture).name, "picture_sha256": digest})


class MetadataTable(TomlTable):
    """`[metadata]`: what a person states for reports and archives; no value depends on it.

    `title` is that of the report, and `licence` that of the data. `operator`, `laboratory` and `environment` (temperature and
    humidity) are those of the measurement. `instrument`, `source` and `receiver` name the hardware beyond the rig file: maker,
    type, serial number. `reference` is the reference standard, and `certificate` the number of its certificate. `samples` has a
    table for each sample.
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
