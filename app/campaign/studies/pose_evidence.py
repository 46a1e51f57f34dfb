"""What the scans of the open beam show of the rig's angles, and whether it contradicts what is stated of the inputs of pose.

A scan's centroid is where the light is against the view, along the arc and across it. All scans share the inputs of the rig;
each has a photodiode and stops of its own. They are observations of one vector of inputs, and their test is one.

Where it is no contradiction the values are corrected by what the scans show, and have the u that they leave.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.measurement_model.pose import photodiode_inputs, rig_inputs
from goniotwin.app.campaign.measurement_model.posterior import Posterior, PosteriorAlignment, SingleError
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.studies.alignment import ScanCentroids
from goniotwin.app.campaign.studies.closure import BY_CHANCE, EDGE_SHARE, ScannedBeam
from goniotwin.app.campaign.wording import concise
from goniotwin.app.rig import nominal_instrument
from goniotwin.app.rig.inputs import POSITION
from goniotwin.keys import ASSUMED

UNLIKELY = 0.05
"""A larger single error than that of so many of the rigs within what is stated is a warning; of BY_CHANCE, a contradiction."""
ALIKE = 4.0
"""Single errors whose squared z is so near to the largest one explain the centroids as well."""
MOST_TIMES = 2.0
"""One that has to be so many times further beyond its stated u than another is no explanation beside it."""
MOST_NAMED = 4

PoseVerdict = Literal["holds", "warns", "fails"]


@dataclass(frozen=True)
class PoseEvidence:
    """The inputs of pose by the centroids of scans of the open beam, at `sigmas_deg`; `alignment` are the inputs afterwards."""

    sigmas_deg: tuple[float, ...]
    posterior: Posterior
    alignment: PosteriorAlignment

    @property
    def verdict(self) -> PoseVerdict:
        """By the chance of the largest single error."""
        chance = self.posterior.chance
        return "fails" if chance < BY_CHANCE else "warns" if chance < UNLIKELY else "holds"

    @property
    def explanations(self) -> list[SingleError]:
        """The single errors that explain the centroids as well as any, and are not many more of their u than the least."""
        errors = self.posterior.single_errors
        alike = [each for each in errors if each.z**2 > errors[0].z ** 2 - ALIKE]
        times = sorted(alike, key=lambda each: abs(each.size) / each.input.u)
        return [each for each in times if abs(each.size) / each.input.u < MOST_TIMES * abs(times[0].size) / times[0].input.u]

    @property
    def text(self) -> str:
        """The finding in one line: what explains it, how well, and what to do."""
        found, named = self.posterior, self.explanations
        sigmas, z = ", ".join(f"{each:g}" for each in self.sigmas_deg), abs(found.single_errors[0].z)
        beam = f"the open beam at sigma {sigmas} deg"
        rank = f"{found.residual.size} centroids, rank {found.rank:.1f} of {len(found.before.inputs)} inputs"
        if self.verdict == "holds":
            return f"{beam} is where the inputs of pose allow it; the largest single error is {z:.1f} u ({rank})"
        listed = ", ".join(
            f"{each.input.name} of {concise(each.size, each.u)} {each.input.unit}" for each in named[:MOST_NAMED]
        )
        more = f" or {len(named) - MOST_NAMED} others" if len(named) > MOST_NAMED else ""
        alone = "would explain it" if len(named) == 1 else "would explain it alone, and the scans do not distinguish them"
        return (
            f"{beam} is not where the inputs of pose allow it, by {z:.1f} u: {listed}{more} {alone} ({rank}; "
            f"{100.0 * found.chance:.2g} % of the rigs as stated are so far off). Correct sigma's zero, mirrors or arc, or "
            "align the rig (goniotwin align), or state larger angles in [uncertainty]"
        )

    def as_dict(self) -> dict[str, Any]:
        """The evidence for JSON; angles in deg."""
        errors = self.posterior.single_errors
        return {
            "sigmas_deg": list(self.sigmas_deg),
            "residual_deg": self.posterior.residual.tolist(),
            "single_errors": [
                {"input": each.input.name, "unit": each.input.unit, "size": each.size, "u": each.u, "z": each.z}
                for each in errors
            ],
        }


def pose_evidence(beams: Sequence[ScannedBeam], settings: ReductionSettings) -> PoseEvidence | None:
    """The inputs of pose by the scans that have all of the beam, about the alignment of the settings or what is stated.

    None without a scan, or where the rig file states no input that could displace one.
    """
    scans, table = [each for each in beams if each.edge <= EDGE_SHARE], settings.rig.uncertainty
    photodiodes = dict.fromkeys(each.scan.photodiode for each in scans)
    before = settings.alignment or Alignment.stated(rig_inputs(table))
    # All values share them: they are corrected by what these photodiodes have seen.
    of_photodiodes = [replace(each, shared_by="all values") for c in photodiodes for each in photodiode_inputs(table, c)]
    before = before.with_inputs(of_photodiodes)
    if not scans or not before.inputs:
        return None
    seen = ScanCentroids.of(scans, before.values, settings, nominal_instrument(settings.rig))
    found = Posterior(before, seen.residual, seen.sensitivity(before, table), np.diag(seen.variance))
    if not found.single_errors:
        return None
    names = [(way, each.scan.at_deg, each.scan.arc) for way in ("along", "across") for each in scans]
    source = f"{table.source(POSITION)}, the steps of a scan"
    errors = [
        InputQuantity(
            f"scan_centroid[{way}, sigma {sigma:g}]@{arc}", "deg", u, "normal", "all values", source, "", origin=ASSUMED
        )
        for (way, sigma, arc), u in zip(names, np.sqrt(seen.variance).tolist(), strict=True)
    ]
    return PoseEvidence(
        tuple(each.scan.at_deg for each in scans), found, found.named_alignment(errors, "scans of the open beam")
    )
