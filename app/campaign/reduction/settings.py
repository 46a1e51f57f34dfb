"""What the steps of a reduction go by: their settings from rig, schedule, certificate and alignment file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from math import inf
from typing import Literal, NamedTuple

import numpy as np

from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.pose import mounting_inputs, rig_inputs
from goniotwin.app.campaign.reduction.arc_geometry import ArcGeometry
from goniotwin.app.campaign.reduction.calibration import CalibrationFactors
from goniotwin.app.campaign.reduction.row_history import RowHistory
from goniotwin.app.campaign.schedule.certificate import Certificate, constant_certificate, parse_certificate, today
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.rig import RigFile
from goniotwin.app.rig.alignment import parse_alignment, refused_residuals
from goniotwin.arrays import Ints
from goniotwin.twin.plant.disturbances import SECOND

OpticalPath = Literal["sample", "etalon", "second standard"]
ASSUMED_YEARS = 1.0
"""Age of an etalon whose calibration has no date."""


class BeamScale(NamedTuple):
    """The `ratio` of the open beam's scale to the certificate's, the relative standard uncertainty `u` of the former, and the
    row of the etalon in both.
    """

    ratio: float
    u: float
    etalon_row: int


@dataclass(frozen=True)
class SecondStandard:
    """What is known of the second standard: its `name`, certificate, and the `years` since its calibration.

    `turned`: it is the etalon itself. `share` is its share in the scale, None for that by the certificates. `difference` is how
    far the two standards are apart, relative, where chance does not explain it: either of them may be wrong then.
    """

    name: str
    certificate: Certificate
    years: float
    turned: bool
    share: float | None = None
    difference: float = 0.0


@dataclass(frozen=True)
class ReductionSettings:
    """What the steps of a reduction go by: rig, schedule, certificate, and the calibration factors of the sample, if any.

    `history`, of a journal, has the mountings, moves and dark readings before each row.
    `sample` is the name of the sample; `etalon_years` the time since the etalon's calibration.
    `absolute` has the scale of the open beam, which scales transmitted light, by wavelength, incidence and whether the arc is
    the lower one.
    `doubted`: the scan of the open beam contradicts the etalon's scale. `alignment` is what is known of the rig's
    misalignments, by which the values are corrected; None without one. `noise_freedom`, by gain, and `lamp_freedom` are the
    degrees of freedom of the readings' noise and of what a row's light has in common; known of a whole journal. `second` is
    the second standard, if there is one.
    """

    rig: RigFile
    geometry: ArcGeometry
    schedule: ScheduleFile
    certificate: Certificate
    calibration: CalibrationFactors | None = None
    history: RowHistory | None = None
    sample: str = ""
    etalon_years: float = 1.0
    absolute: Mapping[tuple[float, float, bool], BeamScale] = field(default_factory=dict)
    doubted: bool = False
    alignment: Alignment | None = None
    noise_freedom: tuple[float, ...] = ()
    lamp_freedom: float = inf
    second: SecondStandard | None = None

    @property
    def sample_number(self) -> int:
        """The place of the sample in the schedule, from 1; 0 for none of it."""
        return {name: k for k, name in enumerate(self.schedule.samples, 1)}.get(self.sample, 0)

    @property
    def calibrates(self) -> bool:
        """Whether the values are multiplied by the calibration factors of the overlaps."""
        return self.schedule.overlap is not None and self.schedule.overlap.calibrate


def reduction_settings(
    rig: RigFile,
    schedule: ScheduleFile,
    certificate: str | None,
    name: str,
    measured: date | None = None,
    alignment: str | None = None,
) -> ReductionSettings:
    """The settings of a reduction; `certificate` is the text of the schedule's certificate, `name` its name in an error.

    `alignment` is the text of the rig's alignment file. Without a certificate it is the rig file's. `measured` is the day of
    the measurement, today if it is missing; where a certificate has no date of calibration, this was a year before. Raises
    UserError.
    """
    parsed = constant_certificate(rig.etalon) if certificate is None else parse_certificate(certificate, name)
    day = measured or today()
    return ReductionSettings(
        rig,
        ArcGeometry(rig),
        schedule,
        parsed,
        etalon_years=_years(parsed, day),
        alignment=None if alignment is None or why_not_aligned(alignment) else rig_alignment(alignment, rig),
        second=_second_standard(schedule, parsed, day),
    )


def _years(certificate: Certificate, day: date) -> float:
    years = certificate.years(day)
    return ASSUMED_YEARS if years is None else years


def _second_standard(schedule: ScheduleFile, of_etalon: Certificate, day: date) -> SecondStandard | None:
    table = schedule.second_standard
    if table is None:
        return None
    certificate = table.certificate(of_etalon)
    return SecondStandard(table.name, certificate, _years(certificate, day), table.turned)


def why_not_aligned(text: str | None) -> str:
    """Why the values of a journal are not corrected by the alignment file in it; empty where they are, or without one.

    A rig file that names such a file is refused; journals of earlier versions have them.
    """
    file = None if text is None else parse_alignment(text, "alignment")
    if file is None or (reason := refused_residuals(file)) is None:
        return ""
    return f"not corrected by {file.source}: {reason}"


def rig_alignment(text: str, rig: RigFile) -> Alignment:
    """What an alignment file has of a rig; the tilt of the sample that it was measured on is not carried on.

    Raises UserError.
    """
    file = parse_alignment(text, "alignment")
    table = rig.uncertainty
    of_rig = rig_inputs(table)
    of_sample = [each for name in file.mountings for each in mounting_inputs(table, "sample", name)]
    return Alignment.of_file(file, [*of_rig, *of_sample], file.source).only([each.name for each in of_rig])


def mounted(kind: OpticalPath, rows: Ints, settings: ReductionSettings) -> tuple[list[str], Ints]:
    """The mountings, as `paint#2`, in which rows (n,) of the sample or of a standard were measured, and which of them each."""
    if settings.history is not None:
        return settings.history.mounted(rows)
    names = {"etalon": settings.schedule.etalon, SECOND: "" if settings.second is None else settings.second.name}
    name = names.get(kind) or settings.sample or kind
    return [f"{name}#1"], np.zeros(rows.size, dtype=np.int64)
