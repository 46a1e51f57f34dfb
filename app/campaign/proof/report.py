"""The totals of a proof as text for a terminal."""

import math
from collections.abc import Iterator

from goniotwin.app.campaign.proof.judgement import SIDES
from goniotwin.app.campaign.proof.pooled import PooledProof, PooledTotals, judgeable
from goniotwin.app.campaign.proof.proof import Proof
from goniotwin.app.campaign.proof.totals import TABLES, UNKNOWN_TABLES, CellTotal, Totals

HEADING = f"{'':28}{'values':>8}{'coverage':>9}{'se':>6}{'mean z':>8}{'se':>6}{'chi2/n':>8}{'> 5 u':>6}"
WIDE = 1e4
"""A larger number has no room in its column as it is."""
WITH_SCATTER = f"{'':28}{'values':>8}{'coverage':>9}{'se':>6}{'u/scatter':>10}{'> 5 u':>6}"
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
        if table in totals.tables:
            yield f"by {'decade, ' if table in SIDES else ''}{table}"
            yield from (_cell(f"  {each.label}", each) for each in totals.tables[table])
    unknown = [table for table in UNKNOWN_TABLES if table in totals.tables]
    if unknown:
        yield WITH_SCATTER
    for table in unknown:
        yield f"by decade, {table}"
        yield from (_cell_with_scatter(f"  {each.label}", each) for each in totals.tables[table])
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
    yield from _far(totals)
    for seed, reason in totals.failed.items():
        yield f"no result: seed {seed}: {reason}"


def pooled_text(proof: PooledProof, found: PooledTotals) -> str:
    """The totals of a pooled proof, a line for each cell, and the cells that miss what is asked of them."""
    return "\n".join(_pooled_lines(proof, found))


def _pooled_lines(proof: PooledProof, found: PooledTotals) -> Iterator[str]:
    totals = found.totals
    how = "through the wires" if proof.wires else "without wires"
    number = f"{found.structures} structure{'' if found.structures == 1 else 's'}"
    yield f"SIMULATED: {number} on {totals.rigs} virtual rigs of {proof.rig.name}, {how}"
    for reasons in proof.drawn_again.values():
        yield from (f"drawn again: {each}" for each in reasons)
    if found.without_value:
        yield f"no good value: structure {', '.join(map(str, found.without_value))}"
    whole = totals.whole
    if whole is None:
        yield "no rig has a value"
        return
    yield "coverage of the 95 % interval, with its standard error over rigs; of: structures with such values"
    yield "u/scatter: median over structures; bound: a limit of the slope is most of u"
    yield f"{WITH_SCATTER}  of"
    yield _pooled_cell("all but the steep ones", whole)
    for table, cells in found.judged.items():
        yield f"by decade, {table}"
        for cell, reason in cells:
            note = "" if judgeable(cell) else "  few"
            yield _pooled_cell(f"  {cell.label}", cell) + (f"  misses: {reason}" if reason else note)
    for table in ("sample", "structure"):
        yield f"by {table}"
        yield from (_pooled_cell(f"  {each.label}", each) for each in totals.tables.get(table, []))
    yield f"chi2/n of what a fit of the shared inputs leaves: {_number(whole.chi_square, '.3f')}"
    yield f"variance of the fitted inputs over their u: {_number(totals.variance_shared, '.3f')}"
    yield f"beyond 5 u: {whole.beyond} values; a normal law gives {whole.expected_beyond:.2g}"
    yield from _far(totals)
    integrals, outside, deviations, beyond = found.outside
    if integrals:
        out, far = (100.0 * part / of for part, of in ((outside, integrals), (beyond, deviations)))
        yield (
            f"reflectances and transmittances: {integrals}, chi2/n over their rigs outside its 99 % limits: {outside} "
            f"({out:.1f} %); beyond 2.58 u: {beyond} of {deviations} ({far:.1f} %)"
        )
    for seed, reason in totals.failed.items():
        yield f"no result: seed {seed}: {reason}"
    names = [f"{table}: {cell.label}" for table, cells in found.judged.items() for cell, reason in cells if reason]
    few = sum(not judgeable(cell) for cells in found.judged.values() for cell, _ in cells)
    count = sum(map(len, found.judged.values()))
    yield f"cells that miss: {'; '.join(names) or 'none'} ({len(names)} of {count - few}; {few} have too few values)"


def _pooled_cell(label: str, cell: CellTotal) -> str:
    return f"{_cell_with_scatter(label, cell)}{cell.structures:4d}"


def _cell_with_scatter(label: str, cell: CellTotal) -> str:
    return (
        f"{label:28}{cell.values:8d}{100.0 * cell.coverage:7.1f} %{_number(100.0 * cell.u_coverage, '.2f'):>6}"
        f"{_number(cell.u_over_scatter, '.2f'):>10}{cell.beyond:6d}"
    )


def _far(totals: Totals) -> Iterator[str]:
    for seed, far in totals.far.items():
        structure = f"structure {far[0]['structure']} " if "structure" in far[0] else ""
        listed = "; ".join(
            f"{each['sample']} {each['wavelength_nm']:g} nm sigma {each['sigma_deg']:g} zenith {each['zenith_deg']:g} azimuth "
            f"{each['azimuth_deg']:g}: {each['deviation_u']:+.1f} u{each['kind'] and ', ' + each['kind']}"
            for each in far[:3]
        )
        yield f"beyond 5 u: {structure}seed {seed}: {listed}{' and more' if len(far) > 3 else ''}"


def _cell(label: str, cell: CellTotal) -> str:
    left = _number(cell.chi_square, ".2f" if cell.chi_square < WIDE else ".1e")
    return (
        f"{label:28}{cell.values:8d}{100.0 * cell.coverage:7.1f} %{_number(100.0 * cell.u_coverage, '.2f'):>6}"
        f"{cell.mean:8.3f}{_number(cell.u_mean, '.3f'):>6}{left:>8}{cell.beyond:6d}"
    )


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "-"
