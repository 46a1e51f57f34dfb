"""The alignment of a rig by one of the samples of its campaign: the lobe, the light and the scans that a journal has for it."""

import math
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.geometry.open_beam import scan_wavelength_nm
from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.studies.alignment import AlignmentResult, estimate_alignment, lobe_points
from goniotwin.app.campaign.studies.closure import ClosureReport
from goniotwin.app.campaign.studies.light_search import LightSeen, Shares
from goniotwin.app.errors import UserError
from goniotwin.app.rig import nominal_instrument
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import round_deg
from goniotwin.twin.optics.geometry.field import scale_field


def align_sample(reduction: Reduction, closure: ClosureReport, sample: str, before: Alignment | None = None) -> AlignmentResult:
    """The alignment by a narrow lobe, at the wavelength of the scans of the open beam, and by these scans.

    `before` is what is known without them; None for what the rig file states. It is not used where the values contradict
    it. Raises UserError where the sample's values determine nothing.
    """
    wavelength = scan_wavelength_nm(reduction.schedule)
    try:
        points = sample_lobe(reduction, sample)
        if points is None:
            raise UserError(f"{sample}: has no lobe of reflected light at {wavelength:g} nm that an alignment could use")
        anew = _estimated(reduction, closure, points, sample, None)
        if before is None:
            return anew
        if anew.alignment.agrees_with(before):
            return _estimated(reduction, closure, points, sample, before)
        return replace(anew, findings=(*anew.findings, _moved(reduction, anew, before)))
    except UserError as error:
        raise UserError(f"{reduction.journal.path}: {error}") from None


def _estimated(
    reduction: Reduction, closure: ClosureReport, points: BsdfPoints, sample: str, before: Alignment | None
) -> AlignmentResult:
    settings = replace(reduction.settings, sample=sample, alignment=before)
    source = f"alignment on {sample} of {reduction.schedule.name}"
    return estimate_alignment(points, settings, closure.beams, source, light_seen(reduction, closure))


def _moved(reduction: Reduction, anew: AlignmentResult, before: Alignment) -> str:
    """That the rig is not where an alignment has it, and what the one that begins anew does not determine."""
    instrument = nominal_instrument(reduction.rig.file)
    names = [each.name for each in before.inputs]
    counts = [len(each.combinations(instrument)[0]) for each in (anew.alignment.only(names), before)]
    fewer = f"; it determines {counts[0]} combinations of the rig, that one {counts[1]}" if counts[0] < counts[1] else ""
    return f"the rig is not where {before.source} has it, and has moved since: this alignment begins anew{fewer}"


def sample_lobe(reduction: Reduction, sample: str) -> BsdfPoints | None:
    """The points of a sample that an alignment can use; None without any."""
    wavelength = scan_wavelength_nm(reduction.schedule)
    found = [lobe_points(each.points.where(each.points.wavelength_nm == wavelength)) for each in reduction.blocks(sample)]
    return BsdfPoints.join(found) if any(each.size for each in found) else None


def light_seen(reduction: Reduction, closure: ClosureReport) -> LightSeen:
    """What etalon and scans of the open beam show of the light on the sample."""
    instrument = nominal_instrument(reduction.rig.file)
    if closure.field is not None:
        instrument = scale_field(instrument, round(math.log(closure.field.ratio), 3))
    return LightSeen(_etalon_shares(reduction), instrument)


def _etalon_shares(reduction: Reduction) -> Shares:
    """The light of the etalon with the sample unit turned, over that at its first gamma."""
    places = reduction.etalon.places[reduction.etalon.places[:, 0] == scan_wavelength_nm(reduction.schedule)]
    signals = reduction.etalon.at((float(each[0]), tuple(each[1:])) for each in round_deg(places).tolist())
    by_pose: dict[tuple[float, float, float], dict[float, Floats]] = {}
    for (_, (gamma, sigma, beta, shift)), each in signals.items():
        by_pose.setdefault((sigma, beta, shift), {})[gamma] = each.signal.value
    found: dict[tuple[float, float, float], list[float]] = {}
    for (sigma, _, _), turned in by_pose.items():
        first = min(turned)
        for gamma, light in turned.items():
            both = np.isfinite(light) & np.isfinite(turned[first])
            here, there = float(light[both].sum()), float(turned[first][both].sum())
            if gamma != first and min(here, there) > 0.0:
                found.setdefault((sigma, gamma, first), []).append(math.log(here / there))
    return {(sigma, gamma): (float(np.mean(each)), first) for (sigma, gamma, first), each in found.items()}
