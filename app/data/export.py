"""What a reduced journal gives to files: all columns of its points in parts, or its scattered values in memory."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.reduction.components import ADDED, interval_rule, shared_variance
from goniotwin.app.campaign.reduction.points import BITS, FLAGS, BsdfPoints, PointSource
from goniotwin.app.campaign.studies.reduced_journal import ReducedJournal
from goniotwin.app.errors import UserError
from goniotwin.app.formats import PointStream
from goniotwin.app.formats.content import CHECK, BsdfFile, ScatteredBsdf, gap_line, psi_of_gamma
from goniotwin.app.formats.metadata import Metadata
from goniotwin.app.formats.points import ABOUT_INTERVAL, SYMMETRY_LINES
from goniotwin.arrays import Flags, Floats, Texts
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, TOLERANCE_DEG, wrap_azimuth

WIDEST_GAP_DEG = 3.0
"""In a table there is no interpolation between measured directions that are further apart."""


def heading(reduced: ReducedJournal) -> list[str]:
    """The first comment lines of a file: campaign, rig, whether it is simulated, the light's polarisation, and findings."""
    lines = [f"campaign: {reduced.name}", f"rig: {reduced.rig.file.name}"]
    if reduced.simulated:
        lines.append(f"SIMULATED: measured on a virtual rig, seed {reduced.rig.seed}; no value is from a real instrument")
    if reduced.chain:
        lines.append(f"journal: {reduced.chain}")
    return [*lines, *reduced.light, *reduced.findings]


def scattered_of(reduced: ReducedJournal, sample: str | None = None, metadata: Metadata | None = None) -> BsdfFile:
    """Every measured point of one sample or of all, in memory, a part each; raises UserError for none."""
    chosen: Mapping[str, PointSource] = {sample: _points(reduced, sample)} if sample is not None else reduced.samples
    if not chosen:
        raise UserError("no sample has been measured yet, so there is nothing to write")
    parts = []
    for name, source in chosen.items():
        columns = [_scattered_columns(points) for points in source.parts(reduced.sizes.points)]
        joined = {key: np.concatenate([each[key] for each in columns]) for key in columns[0]}
        symmetry = (f"symmetry: {reduced.symmetry[name]}",) if name in reduced.symmetry else ()
        parts.append(_scattered(joined, name, reduced.isotropic, reduced.simulated, symmetry))
    return BsdfFile(tuple(parts), metadata or Metadata(title=reduced.name), tuple(heading(reduced)))


def scattered_points(points: BsdfPoints, sample: str, *, isotropic: bool, generated: bool) -> ScatteredBsdf:
    """Reduced points in the frame of the sample; `isotropic` as the schedule states it."""
    return _scattered(_scattered_columns(points), sample, isotropic, generated)


def _scattered(
    columns: dict[str, np.ndarray], sample: str, isotropic: bool, generated: bool, comments: tuple[str, ...] = ()
) -> ScatteredBsdf:
    return ScatteredBsdf(
        **columns, sample=sample, isotropic=isotropic, generated=generated, comments=comments, widest_gap_deg=WIDEST_GAP_DEG
    )


def _scattered_columns(points: BsdfPoints) -> dict[str, np.ndarray]:
    """The columns of scattered values, in the sample's frame; that of one lit on its back is turned about x."""
    psi = psi_of_gamma(points.gamma_deg, points.back)
    low, high, law = points.interval
    return {
        "sigma_deg": np.where(points.back, HALF_TURN_DEG - points.sigma_deg, points.sigma_deg),
        "psi_deg": psi,
        "polar_deg": polar_from_zenith(points.zenith_deg),
        "azimuth_deg": wrap_azimuth(np.where(points.back, -points.azimuth_deg, points.azimuth_deg) + psi),
        "values": points.bsdf,
        "u": points.u_bsdf,
        "u_shared": np.sqrt(shared_variance(points.components)),
        "low95": low,
        "high95": high,
        "interval": law,
        "wavelength_nm": points.wavelength_nm,
        "transmitted": points.transmitted,
        "back": points.back,
        "photodiode": points.photodiode,
        "flags": _flags(points, CHECK),
    }


def points_of(reduced: ReducedJournal, sample: str | None, path: Path) -> tuple[PointStream, int]:
    """Every measured point of one sample or of all, in parts, and their number. Raises UserError."""
    chosen: Mapping[str, PointSource] = {sample: _points(reduced, sample)} if sample is not None else reduced.samples
    if not chosen:
        raise UserError(f"{path}: no sample has been measured yet, so there is nothing to write")
    about = [
        *heading(reduced),
        *(f"{name}: {line}" for name in chosen if name in reduced.metadata for line in _record(reduced.metadata[name])),
        "sigma: incidence; theta, phi: observation about the specular direction, phi 0 towards the normal; degrees",
        "bsdf with its standard uncertainty u_bsdf in 1/sr; luminance_factor is pi times bsdf",
        "side: the lit side, front or back; light: reflected or transmitted",
        gap_line(WIDEST_GAP_DEG),
        SYMMETRY_LINES[reduced.isotropic],
        "check: mirrored, for a direction measured only to check the stated symmetry",
        "signature_share: the instrument signature's share of the signal, already subtracted; empty where not measured",
        interval_rule(", ".join(sorted(ADDED))),
        ABOUT_INTERVAL,
        "field_correction: what the correction of the finite field of view has added to the logarithm of bsdf",
        "u_field_per_sr: what is left of the field of view in u_bsdf; empty where it cannot be estimated",
        "u_shared_per_sr: the part of u_bsdf that neighbouring values share",
        f"flags: {', '.join(f'{name} ({flag.meaning})' for name, flag in FLAGS.items())}",
        *(note for note in reduced.notes if note not in (*reduced.light, *reduced.findings)),
        *(f"overlaps of {name}: {each}" for name, each in reduced.overlaps.items() if name in chosen and each.pairs),
    ]
    parts = (_columns(name, points) for name, source in chosen.items() for points in source.parts(reduced.sizes.points))
    return PointStream(about, parts), sum(source.size for source in chosen.values())


def _record(known: Metadata) -> list[str]:
    """What is stated of a sample and of who has measured it, one line each."""
    return Metadata(laboratory=known.laboratory, operator=known.operator, sample=known.sample).lines()


@dataclass(frozen=True)
class _SomePoints:
    """Those points of a source that a choice takes."""

    source: PointSource
    takes: Callable[[BsdfPoints], Flags]

    @property
    def size(self) -> int:
        """Number of points."""
        return sum(points.size for points in self.parts(BlockSizes.points))

    def parts(self, points: int) -> Iterator[BsdfPoints]:
        """The points in order of time."""
        return self._chosen(self.source.parts(points))

    def settings(self, wavelength_nm: float | None = None) -> Iterator[BsdfPoints]:
        """The points of each wavelength, or of one, and sigma."""
        return self._chosen(self.source.settings(wavelength_nm))

    def _chosen(self, parts: Iterator[BsdfPoints]) -> Iterator[BsdfPoints]:
        return (chosen for points in parts if (chosen := points.where(self.takes(points))).size)


def part_of_light(reduced: ReducedJournal, sample: str | None, path: Path, light: str) -> ReducedJournal:
    """The samples that were measured in this light, with its points alone. Raises UserError for none."""
    part = _some(reduced, sample, lambda points: np.asarray(points.transmitted == (light == "transmitted")))
    if not part.samples:
        raise UserError(f"{path}: no {light} light of {sample or 'any sample'} has been measured; leave --light out")
    return part


def part_of_wavelength(reduced: ReducedJournal, sample: str | None, wavelength_nm: float) -> ReducedJournal:
    """The samples that were measured at this wavelength, with its points alone."""
    return _some(reduced, sample, lambda points: np.asarray(np.abs(points.wavelength_nm - wavelength_nm) <= TOLERANCE_DEG))


def wavelengths_of(reduced: ReducedJournal, sample: str | None) -> Floats:
    """The wavelengths at which one sample, or any, was measured, ascending."""
    chosen = reduced.samples.values() if sample is None else [_points(reduced, sample)]
    found = [np.unique(points.wavelength_nm) for source in chosen for points in source.parts(reduced.sizes.points)]
    return np.unique(np.concatenate([np.zeros(0), *found]))


def _some(reduced: ReducedJournal, sample: str | None, takes: Callable[[BsdfPoints], Flags]) -> ReducedJournal:
    """The points of one sample, or of all, that a choice takes, without samples that have none."""
    asked: Mapping[str, PointSource] = reduced.samples if sample is None else {sample: _points(reduced, sample)}
    chosen = {name: _SomePoints(source, takes) for name, source in asked.items()}
    return ReducedJournal(**{**vars(reduced), "samples": {name: source for name, source in chosen.items() if source.size}})


def _points(reduced: ReducedJournal, sample: str) -> PointSource:
    """The points of a sample. Raises UserError for an unknown name."""
    if sample not in reduced.samples:
        known = ", ".join(map(repr, reduced.samples)) or "none"
        raise UserError(f"the journal has no measured sample {sample!r}; it has: {known}")
    return reduced.samples[sample]


def _columns(name: str, points: BsdfPoints) -> dict[str, np.ndarray]:
    """The columns of a CSV for points of one sample."""
    columns: dict[str, np.ndarray] = {"sample": np.full(points.bsdf.size, name)}
    for column in (
        "wavelength_nm",
        "sigma_deg",
        "gamma_deg",
        "beta_deg",
        "shift_deg",
        "photodiode",
        "zenith_deg",
        "azimuth_deg",
        "theta_deg",
        "phi_deg",
        "bsdf",
        "u_bsdf",
        "luminance_factor",
    ):
        unit = "_per_sr" if column in ("bsdf", "u_bsdf") else ""
        columns[column + unit] = getattr(points, column)
    columns["side"] = np.where(points.back, "back", "front")
    columns["light"] = np.where(points.transmitted, "transmitted", "reflected")
    columns["check"] = np.where(points.mirrored, CHECK, "")
    columns["signature_share"] = points.signature
    columns["field_correction"] = points.field_correction
    columns["u_field_per_sr"] = points.u_field
    columns["u_shared_per_sr"] = np.sqrt(shared_variance(points.components))
    columns["low95_per_sr"], columns["high95_per_sr"], columns["interval"] = points.interval
    columns["flags"] = _flags(points)
    return columns


def _flags(points: BsdfPoints, of_checks: str = "") -> Texts:
    """The flags of each point in words; with the word `of_checks` for one that only checks the symmetry."""
    marks = points.marks.astype(np.int64) << 1 | (points.mirrored if of_checks else 0)
    distinct, which = np.unique(marks, return_inverse=True)
    words = [
        " ".join([*(name for name in FLAGS if mark >> 1 & int(BITS[name])), *([of_checks] if mark & 1 else [])])
        for mark in distinct.tolist()
    ]
    texts: Texts = np.array(words, dtype=np.str_)
    return np.asarray(texts[which.ravel()])
