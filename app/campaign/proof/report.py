"""The totals of a proof as text for a terminal."""

import math
from collections.abc import Iterator

from goniotwin.app.campaign.proof.proof import Proof
from goniotwin.app.campaign.proof.totals import TABLES, CellTotal, Totals

HEADING = f"{'':28}{'values':>8}{'coverage':>9}{'se':>6}{'mean z':>8}{'se':>6}{'chi2/n':>8}{'> 5 u':>6}"
WIDE = 1e4
"""A larger number has no room in its column as it is."""
INPUTS = f"{'':28}{'variance / u2':>14}{'determined':>12}"


def proof_text(proof: Proof, totals: Totals) -> str:
    """The totals, a line for each cell."""
    return "\n".join(_lines(proof, totals))


def _lines(proof: Proof, totals: Totals) -> Iterator[str]:
    how = "through the wires" if proof.wires else "without wires"
    rigs = f"{totals.rigs} virtual rig{'' if totals.rigs == 1 else 's'}"
    yield f"SIMULATED: {proof.schedule.file.name} on {rigs} of {proof.rig.name}, {how}"
    whole, worst = totals.whole, totals.worst
    if whole is None:
        yield "no rig has a value"
        return
    yield "coverage of the 95 % interval, with its standard error over rigs; chi2/n of what a fit of the shared inputs leaves"
    yield HEADING
    yield _cell("all", whole)
    for table in TABLES:
        yield f"by {table}"
        yield from (_cell(f"  {each.label}", each) for each in totals.tables.get(table, []))
    if worst is not None:
        yield f"worst cell: {worst[0]} {worst[1].label}, {100.0 * worst[1].coverage:.1f} %"
    yield f"beyond 5 u: {whole.beyond} values; a normal law gives {whole.expected_beyond:.2g}"
    yield f"variance of the fitted inputs over their u: {_number(totals.variance_shared, '.3f')}"
    if totals.inputs:
        yield "by kind of input; determined: how many inputs of a rig the values determine"
        yield INPUTS
    for kind, (square, expected, count) in totals.inputs.items():
        if expected > 0.0:
            yield f"{f'  {kind}':28}{square / expected:14.2f}{expected / count:12.2g}"
    for name, (correlation, difference) in totals.angles.items():
        yield (
            f"angle in the plane of incidence, fitted to {name} and as drawn: correlation {_number(correlation, '.4f')}, rms "
            f"difference {difference:.4f} deg"
        )
    for each in totals.reflectances:
        low, high = each.limits
        yield (
            f"integral of {each.label}: chi2/n {each.chi_square:.2f} (99 % limits {low:.2f} to {high:.2f}), u over scatter "
            f"{_number(each.u_over_scatter, '.2f')}"
        )
    for seed, far in totals.far.items():
        listed = "; ".join(
            f"{each['sample']} {each['wavelength_nm']:g} nm sigma {each['sigma_deg']:g} zenith {each['zenith_deg']:g} azimuth "
            f"{each['azimuth_deg']:g}: {each['deviation_u']:+.1f} u"
            for each in far[:3]
        )
        yield f"beyond 5 u: seed {seed}: {listed}{' and more' if len(far) > 3 else ''}"
    for seed, reason in totals.failed.items():
        yield f"no result: seed {seed}: {reason}"


def _cell(label: str, cell: CellTotal) -> str:
    left = _number(cell.chi_square, ".2f" if cell.chi_square < WIDE else ".1e")
    return (
        f"{label:28}{cell.values:8d}{100.0 * cell.coverage:7.1f} %{_number(100.0 * cell.u_coverage, '.2f'):>6}"
        f"{cell.mean:8.3f}{_number(cell.u_mean, '.3f'):>6}{left:>8}{cell.beyond:6d}"
    )


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "-"
