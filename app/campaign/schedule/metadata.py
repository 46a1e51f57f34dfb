"""`[metadata]` of the schedule: what a person states about a campaign. The rest is in rig file and journal."""

import unicodedata
from typing import Annotated

from pydantic import AfterValidator, Field

from goniotwin.app.toml_file import TomlTable

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
    """

    identifier: Text = ""
    maker: Text = ""
    description: Text = ""
    side: Text = ""
    azimuth_mark: Text = ""
    preparation: Text = ""


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
