"""Samples of a virtual rig that give no light at all where they are measured: an etalon with a bare back, an opaque sheet."""

from collections.abc import Iterator

from goniotwin.app.campaign.planning.directions import Seen
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.planning.sides import lighting_deg, lit_arc
from goniotwin.twin.optics import Scatterer


def lightless(plan: Plan, seen: list[Seen]) -> Iterator[str]:
    """A warning for each; what a real rig's samples do nobody knows."""
    if not any(each.transmitted for each in seen) and plan.schedule.file.side == "front":
        return  # what reflects nothing from its front nobody measures
    model = plan.rig.model()
    if model is None:
        return
    file = plan.schedule.file
    bare = sorted({_side(lighting_deg(each.sigma_deg, each.arc)) for each in seen})
    for side in bare:
        if not _scatters(model.samples[file.etalon], side, transmitted=False):
            light = _kinds(each for each in seen if _side(lighting_deg(each.sigma_deg, each.arc)) == side)
            yield (
                f"{file.etalon} reflects nothing when its {side} is lit, so that {light} has no scale and no value: "
                "take an etalon that scatters on both sides"
            )
    for sample in file.samples:
        for side, transmitted in sorted({(_side(each.sigma_deg), each.transmitted) for each in seen}):
            if not _scatters(model.samples[sample], side, transmitted=transmitted):
                does = "lets nothing through" if transmitted else "reflects nothing"
                yield (
                    f"{sample} {does} when its {side} is lit: what is measured there is noise; "
                    "is it the right sample, side or light?"
                )


def _side(sigma_deg: float) -> str:
    return "front" if lit_arc(sigma_deg) == "upper" else "back"


def _kinds(seen: Iterator[Seen]) -> str:
    kinds = sorted({"transmitted" if each.transmitted else "reflected" for each in seen})
    return f"{' and '.join(kinds)} light"


def _scatters(sample: Scatterer, side: str, *, transmitted: bool) -> bool:
    incident = 1 if side == "front" else -1
    return any(lobe.incident == incident and lobe.transmits == transmitted for lobe in sample.lobes)
