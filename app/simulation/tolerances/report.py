"""Report of a tolerance study: the paper's table beside ours, assumptions, explanations; terminal, JSON and CSV."""

import math
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from goniotwin.app.formats import PointStream
from goniotwin.app.formats.registry import Holds
from goniotwin.app.simulation.files import write_content
from goniotwin.app.simulation.paper.gaussian_cut import HIGHEST_ZENITH_DEG
from goniotwin.app.simulation.tolerances.elements_figure import write_elements
from goniotwin.app.simulation.tolerances.figure import write_figures
from goniotwin.app.simulation.tolerances.result import AfterRecentring, Case, Sensitivities, StudyResult
from goniotwin.app.simulation.tolerances.stages import CONFIRMED, Combinations
from goniotwin.app.simulation.tolerances.study import LIGHTS, FluxTable, GaussianTable, InstrumentTable, Parameter
from goniotwin.app.simulation.tolerances.unit_light import LightComparison
from goniotwin.arrays import Floats
from goniotwin.twin.optics import IlluminationUnit

PAPER = {1: {"deg": 0.05, "mm": 0.025}, 2: {"deg": 0.05, "mm": 0.1}}
"""Permissible deviations of the paper's Tables 1 and 2, by unit."""
KINDS = {"deg": "angular", "mm": "spatial"}
CELLS = 200
"""Number of rows of the distribution in the CSV."""


def quantity(result: StudyResult) -> str:
    """What the criterion of the study is, in a few words."""
    return "change of the flux" if isinstance(result.study.criterion, FluxTable) else "relative RMS (formula 5)"


def assumptions(result: StudyResult) -> dict[str, str]:
    """The assumptions of the study by topic."""
    study, case = result.study, result.case
    drawn = case.combinations
    combined = (
        f"all {drawn.percent.size} combinations of the steps{_describe_surrogate(drawn)}"
        if drawn.complete
        else f"{drawn.percent.size} random corners, counted with a standard error, and the worst corner by search"
    )
    common = {
        "deviations": f"{len(case.parameters)}: {describe_deviations(case.parameters)}",
        "combinations": combined + "; the factor of the limits is the largest with which no combination fails",
        "yields": f"{study.yields.draws} instruments; uniform within the limits, or normal with the limits at "
        f"{study.yields.limit_sigmas:g} standard deviations",
    }
    if study.illumination is not None:
        common["illumination unit"] = (
            f"{study.illumination.draws} random combinations of the steps, the same in every light; deviations of the unit: "
            f"{describe_deviations(_light_of(result).parameters)}; anew: at random limits, others for each combination; "
            "frozen: at their worst corner for the flux, as the paper's rayset; slit's image and radiance are exact, as those "
            "of a rayset without end"
        )
    return {
        **(_flux_assumptions(study.criterion) if isinstance(study.criterion, FluxTable) else _lobe_assumptions(result)),
        **common,
    }


def _flux_assumptions(criterion: FluxTable) -> dict[str, str]:
    unit = IlluminationUnit()
    width, height = (each * unit.output_condenser_magnification for each in unit.opening_mm)
    return {
        "criterion": f"flux into {unit.field_side_mm:g} x {unit.field_side_mm:g} mm across the axis, "
        f"{unit.sample_distance_mm:g} mm from the exit pupil, relative to that without deviations; the paper has 5-10 %",
        "light": f"the slit's image is {width:g} x {height:g} mm, so that the square has a margin of "
        f"{0.5 * (width - unit.field_side_mm):g} mm; ideal lenses; {unit.wavelength_nm:g} nm; the condensers and the height "
        "stop are assumed, the paper does not state them",
        "estimator": "a quadrature over pupil and square, without random numbers; the worst corner is confirmed by "
        f"{criterion.rays} adjoint rays",
        "uniformity": "lowest irradiance over the mean, of 5 x 5 cells; it is stated beside, the paper has no limit for it",
    }


def _lobe_assumptions(result: StudyResult) -> dict[str, str]:
    criterion, table = result.study.criterion, result.study.instrument
    assert isinstance(criterion, GaussianTable)
    instrument = table.instrument()
    form = "1/e at the width" if criterion.form == "one_over_e" else "half at the width"
    sigmas = ", ".join(f"{each:g}" for each in criterion.sigma_deg)
    where = "the whole lobe"
    if criterion.directions == "plane":
        both = max(criterion.sigma_deg) + criterion.widths * criterion.width_deg < HIGHEST_ZENITH_DEG
        where = f"the plane of incidence, {'both sides' if both else 'cut on one side'} of the specular direction"
    return {
        "criterion": f"formula 5 against a Gaussian of {criterion.width_deg:g} deg ({form}), at most "
        f"{criterion.within_percent[0]:g} %",
        "range of i": f"sigma {sigmas} deg, {where}, theta up to {criterion.widths:g} widths in steps of "
        f"{criterion.step_deg:g} deg, zenith angle below 85 deg; the paper does not state it",
        "beam": describe_beam(table),
        "detectors": f"discs of {instrument.detector_diameter_mm:g} mm at {instrument.arc_radius_mm:g} mm with a field of "
        f"{instrument.field_deg:g} deg; obstruction {'on' if instrument.obstruction else 'off'}",
        "estimator": "fast, without noise; the etalon is an ideal diffuser",
    }


def _describe_surrogate(drawn: Combinations) -> str:
    error = drawn.surrogate_error_percent
    if error is None:
        return ""
    return (
        f", by a surrogate to the second order of the deviations; at {CONFIRMED} random ones and at the worst it is within "
        f"{error:.2g} percentage points of the exact values, and the worst is exact"
    )


def _light_of(result: StudyResult) -> LightComparison:
    assert result.lights is not None
    return result.lights


def describe_beam(table: InstrumentTable) -> str:
    """The beam of an instrument, in words."""
    if table.collimated:
        return "collimated: the exit pupil is at infinity, each mirror turns the light in full"
    instrument = table.instrument()
    return (
        f"from an evenly lit pupil of {instrument.pupil_radius_mm:g} mm radius at {instrument.pupil_distance_mm:g} mm, "
        f"{instrument.divergence_deg:.3f} deg full width"
    )


def describe_deviations(parameters: tuple[Parameter, ...]) -> str:
    """Elements with the names of their deviations, as text."""
    elements: dict[str, list[str]] = {}
    for each in parameters:
        elements.setdefault(each.element, []).append(each.name)
    return ", ".join(f"{element.replace('_', ' ')} {' '.join(names)}" for element, names in elements.items())


def describe_corner(case: Case) -> str:
    """The deviations of the worst combination with their signs, as text."""
    signs = {1: "+", 0: "0 ", -1: "-"}
    return ", ".join(f"{signs[int(s)]}{each.title}" for s, each in zip(case.worst.levels, case.parameters, strict=True))


def explanations(result: StudyResult) -> list[str]:
    """What the numbers mean, and how far they explain the paper's table."""
    case, within = result.case, result.case.combinations.within[0]
    worst_of, alone = case.worst_alone
    (share, error), *_ = case.combinations.shares
    found = [
        f"Alone: the largest effect is {worst_of.title}, {_criterion(alone)} at +-{worst_of.limit:g} {worst_of.unit}; the "
        f"limit of {within:g} % is reached at {_least_alone(case)}.",
        f"Together: {_percent(share, error)} of the combinations are within {within:g} %. The worst one has "
        f"{_criterion(case.worst.percent)}."
        + (" Limits that hold for each deviation alone do not hold for all of them." if case.common.factor < 1.0 else ""),
        f"The search found the worst corner in {case.worst.evaluated} evaluations. "
        + (
            f"The enumeration of all {case.combinations.percent.size} combinations gives "
            f"{_criterion(case.combinations.worst_percent)}."
            if case.combinations.complete
            else f"A worse one may exist: not all are evaluated. The worst of {case.combinations.percent.size} random corners "
            f"has {_criterion(case.combinations.worst_percent)}."
        ),
    ]
    dark = int(np.count_nonzero(np.isinf(case.combinations.percent)))
    if dark:
        found.append(f"{dark} of the combinations have directions without light. They have no value and count as failed.")
    if case.common.factor < 1.0:
        found.append(
            f"Reduced until none fails: one factor for all limits, {case.common.factor:.3f}, gives {_common_limits(case)}. If "
            f"instead each limit alone is reduced, insensitive elements keep wider limits: {_individual_range(case)}."
        )
    span = case.combinations.surviving / np.array([each.limit for each in case.parameters])[:, None]
    if share < 1.0 and np.all(span[:, 0] <= -0.99) and np.all(span[:, 1] >= 0.99):
        found.append(
            "The paper removes the combinations that fail and takes the ranges of the rest. Each deviation alone passes at its "
            "limit, so it keeps its whole range among those that pass. Read in this way, the paper's limits come out as they "
            f"went in, although {100.0 * (1.0 - share):.0f} % of the combinations fail."
        )
    found += [text for each in result.variants for text in _explain_variant(result, each)]
    if result.recentred is not None:
        found.append(_explain_recentring(result.recentred))
    if result.lights is not None:
        found += _explain_lights(result.lights)
    if result.uniformity is not None:
        even = result.uniformity
        found.append(
            f"{even.by_rays.rays} adjoint rays confirm the worst corner of the flux: it loses "
            f"{100.0 * (1.0 - even.by_rays.flux):.2f}({100.0 * even.by_rays.flux_error:.2f}) %."
        )
        found.append(
            f"Uniformity: {even.aligned:.2f} without deviations. The worst corner of the flux has {even.flux_at_worst:.2f} of "
            f"the flux and a uniformity of {even.at_worst:.2f}. The worst corner of the uniformity itself has "
            f"{even.lowest:.2f}. A corner of the square is dark before a tenth of the flux is lost, and a limit of the flux "
            "alone permits that."
        )
    return found


def _explain_variant(result: StudyResult, variant: Case) -> list[str]:
    """What a variant has to say of deviations of a kind that the study itself has not, such as shifts beside tilts."""
    paper, own = PAPER.get(result.study.paper or 0, {}), _units(result.case)
    if {each.unit for each in variant.parameters} & own:
        return []
    within, text = variant.combinations.within[0], []
    for unit in _units(variant):
        limit = max(each.limit for each in variant.parameters if each.unit == unit)
        text.append(
            f"{variant.name}: all at +-{limit:g} {unit} together have {_criterion(variant.worst.percent)} at the worst corner, "
            f"and {_criterion(variant.aligned_percent)} without deviations. A single one reaches {within:g} % at "
            f"{_least_alone(variant)}, no other one earlier."
        )
        if variant.common.factor == 1.0 and unit in paper:
            text.append(
                f"So this criterion alone does not lead to the paper's +-{paper[unit]:g} {unit}, if the paper has these "
                "dimensions. It states no other criterion."
            )
    return [" ".join(text)]


def _units(case: Case) -> set[str]:
    return {each.unit for each in case.parameters}


def _criterion(percent: float) -> str:
    return f"{percent:.2f} %" if math.isfinite(percent) else "without a value"


def _explain_lights(lights: LightComparison) -> list[str]:
    even, aligned = lights.of("even"), lights.of("aligned")
    assert even is not None
    assert aligned is not None
    found = [
        f"The slit's image: with its edges the worst corner has {aligned.worst.percent:.2f} %, with an evenly lit hole "
        f"{even.worst.percent:.2f} %. Where a part of the hole is dark, the middle of the light moves. The median flux is "
        f"{np.median(aligned.flux):.3f}, the least {aligned.flux.min():.2f}."
    ]
    anew, frozen, difference = lights.of("anew"), lights.of("frozen"), lights.difference
    if difference is None or anew is None or frozen is None:
        return found
    (share, error), *_ = difference.shares
    found.append(
        f"Frozen minus anew: the frozen unit stands at its worst corner, which has {lights.frozen_flux:.2f} of the flux. The "
        f"median changes by {_points(difference.median_percent)}, the share within {anew.combinations.within[0]:g} % by "
        f"{100.0 * share:+.1f}({100.0 * error:.1f}) points, and the worst corner by {_points(difference.worst_percent)}. The "
        f"median flux changes by {difference.median_flux:+.3f}, the least flux by {difference.least_flux:+.2f}. One "
        f"combination changes by up to {difference.largest_percent:.2f} points."
    )
    worse = (
        "So the paper's rayset is not the worst light for formula 5."
        if anew.worst.percent > frozen.worst.percent
        else "Here the worst light for the flux is also the worst for formula 5."
    )
    found.append(
        "Formula 5 compares sample and etalon in the same light. The unit changes it only by moving the middle of the light "
        f"within the hole. {worse} The flux follows the unit in full: with the frozen unit every combination begins with the "
        "loss of its worst corner."
    )
    return found


def _points(value: float) -> str:
    return f"{value:+.2f} points"


def _explain_recentring(after: AfterRecentring) -> str:
    if not math.isfinite(after.peak_at_worst_deg):
        return "At the worst corner some directions have no light, so there is no measured peak to recentre on."
    others = [each for each in after.limitations[2:] if each.factor < 1.0]
    least = min(after.limitations[2:], key=lambda each: each.factor)
    text = (
        f"About the measured peak: the worst corner moves the peak by {after.peak_at_worst_deg:.2f} deg. Taken about the moved "
        f"peak, its criterion is {after.at_worst_percent:.2f} % (without deviations {after.aligned_percent:.2f} %), and no "
        f"corner exceeds {after.worst.percent:.2f} %. What this removes is the shift of the specular direction. The peak does "
        "not show the incidence, the absolute scale, or the place of the light on the sample. "
    )
    if not others:
        return text + f"None of these exceeds its limit here. The nearest is the {least.name}."
    listed = " ".join(
        f"The {each.name} reaches {each.worst:.2f} {each.unit} and may have {each.limit:g} {each.unit}; "
        f"{100.0 * each.factor:.0f} % of all limits would keep it."
        for each in others
    )
    return text + f"These then limit the deviations. {listed}"


def _percent(share: float, error: float) -> str:
    return f"{100.0 * share:.1f} %" if error == 0.0 else f"{100.0 * share:.1f}({100.0 * error:.1f}) %"


def _by_unit(case: Case, values: Floats) -> dict[str, tuple[float, Parameter]]:
    """The least value of each unit, and its deviation."""
    found: dict[str, tuple[float, Parameter]] = {}
    for value, parameter in zip(values.tolist(), case.parameters, strict=True):
        if parameter.unit not in found or value < found[parameter.unit][0]:
            found[parameter.unit] = (value, parameter)
    return found


def _least_alone(case: Case) -> str:
    least = _by_unit(case, case.alone.permitted[:, 0])
    return " and ".join(
        f"{value:.3g} {unit} ({parameter.title})" if math.isfinite(value) else f"more than {_searched_to(case, unit)}"
        for unit, (value, parameter) in least.items()
    )


def _searched_to(case: Case, unit: str) -> str:
    largest = min(float(case.alone.largest[k]) for k, each in enumerate(case.parameters) if each.unit == unit)
    return f"{largest:g} {unit}"


def _common_limits(case: Case) -> str:
    pairs = {(each.unit, each.limit): case.common.factor * each.limit for each in case.parameters}
    return " and ".join(f"+-{value:.4f} {unit}" for (unit, _), value in pairs.items())


def _individual_range(case: Case) -> str:
    least = _by_unit(case, case.individual.limits)
    greatest = _by_unit(case, -case.individual.limits)
    return "; ".join(
        f"from {value:.3g} {unit} ({parameter.title}) to {-greatest[unit][0]:.3g} {unit} ({greatest[unit][1].title})"
        for unit, (value, parameter) in least.items()
    )


def print_study(console: Console, result: StudyResult) -> None:
    """Print the tables, the assumptions and the explanations."""
    for table in _tables(result):
        console.print(table)
        console.print()
    console.print("assumptions", style="bold")
    for topic, text in assumptions(result).items():
        _print_item(console, f"{topic}: {text}")
    console.print("\nexplanations", style="bold")
    for text in explanations(result):
        _print_item(console, text)
    for case in result.cases:
        _print_item(console, f"worst corner{f', {case.name}' if case.name else ''}: {describe_corner(case)}")


def _tables(result: StudyResult) -> list[Table]:
    tables = [_paper_table(result), _deviation_table(result)]
    if result.sensitivities is not None:
        tables.append(_sensitivity_table(result, result.sensitivities))
    tables.append(_case_table(result))
    if result.recentred is not None:
        tables.append(_limitation_table(result.recentred))
    if result.lights is not None:
        tables.append(_light_table(result.lights))
    return tables


def _new_table(title: str, *columns: str) -> Table:
    table = Table(title=f"SIMULATED: {title}", title_justify="left")
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left", overflow="fold")
    return table


def _paper_table(result: StudyResult) -> Table:
    paper = PAPER.get(result.study.paper or 0, {})
    table = _new_table(
        f"{result.study.name}, permissible deviations",
        "deviations",
        "paper",
        "each alone",
        "all, by one factor",
        "all, individually",
    )
    for case in result.cases:
        alone = _by_unit(case, case.alone.permitted[:, 0])
        common, individual = _by_unit(case, case.common.limits), _by_unit(case, case.individual.limits)
        enough = "at least " if case.common.factor == 1.0 else ""
        # A variant has a row for a kind of deviation that the study itself has not.
        for unit in alone if case is result.case else alone.keys() - _units(result.case):
            value = alone[unit][0]
            table.add_row(
                f"{KINDS[unit]}, {case.name}" if case.name else KINDS[unit],
                f"+-{paper[unit]:g} {unit}" if unit in paper else "",
                f"+-{value:.3f} {unit}" if math.isfinite(value) else f"more than {_searched_to(case, unit)}",
                f"{enough}+-{common[unit][0]:.4f} {unit}",
                f"from +-{individual[unit][0]:.4f} {unit}",
            )
    return table


def _deviation_table(result: StudyResult) -> Table:
    case = result.case
    table = _new_table(
        f"each deviation alone, {quantity(result)}; and limits of all together",
        "deviation",
        "range",
        "at -, %",
        "at +, %",
        *(f"{each:g} % at" for each in case.combinations.within),
        "one factor",
        "individual",
    )
    for k, parameter in enumerate(case.parameters):
        largest = float(case.alone.largest[k])
        table.add_row(
            parameter.title,
            f"{parameter.limit:g} {parameter.unit}",
            *(f"{value:.2f}" for value in case.alone.percent[k]),
            *(f"{value:.3f}" if math.isfinite(value) else f"> {largest:g}" for value in case.alone.permitted[k]),
            f"{case.common.limits[k]:.4f}",
            f"{case.individual.limits[k]:.4f}",
        )
    return table


def _sensitivity_table(result: StudyResult, slopes: Sensitivities) -> Table:
    table = _new_table(
        "sensitivities, for a deviation of 1 deg or 1 mm", "deviation", "unit", "peak, deg", "incidence, deg", "place, mm"
    )
    for k, parameter in enumerate(result.case.parameters):
        row = (_signed(slopes.peak_deg[k]), _signed(slopes.incidence_deg[k]), f"{slopes.place_mm[k]:.2f}")
        table.add_row(parameter.title, parameter.unit, *row)
    return table


def _signed(value: float) -> str:
    text = f"{value:+.3f}"
    return text if text.strip("+-0.") else "0"


def _case_table(result: StudyResult) -> Table:
    within = result.case.combinations.within
    table = _new_table(
        f"all deviations, {quantity(result)} in %; standard errors in brackets",
        "",
        "number",
        "aligned",
        "alone",
        "median",
        "worst",
        *(f"within {each:g}" for each in within),
        "factor",
    )
    for case in result.cases:
        drawn = case.combinations
        table.add_row(
            case.name or f"{len(case.parameters)} deviations",
            f"{drawn.percent.size}" if drawn.complete else f"{drawn.percent.size} corners",
            f"{case.aligned_percent:.2f}",
            f"{case.worst_alone[1]:.2f}",
            f"{np.median(drawn.percent):.2f}",
            f"{case.worst.percent:.2f}",
            *(_percent(*each).removesuffix(" %") for each in drawn.shares),
            f"{case.common.factor:.4f}",
        )
    for name, drawn in result.yields.items():
        middle, largest = f"{np.median(drawn.percent):.2f}", f"{drawn.worst_percent:.2f}"
        shares = (_percent(*each).removesuffix(" %") for each in drawn.shares)
        table.add_row(f"yield, {name}", f"{drawn.percent.size} drawn", "", "", middle, largest, *shares, "")
    return table


def _limitation_table(after: AfterRecentring) -> Table:
    table = _new_table("what limits the deviations, all together", "quantity", "limit", "worst corner", "factor")
    for each in after.limitations:
        table.add_row(each.name, f"{each.limit:g} {each.unit}", f"{each.worst:.2f} {each.unit}", f"{each.factor:.3f}")
    return table


def _light_table(lights: LightComparison) -> Table:
    within = lights.lights[0].combinations.within
    table = _new_table(
        "all deviations in the light of the illumination unit; relative RMS in %, flux relative to that without deviations",
        "light",
        "median",
        "worst drawn",
        "worst found",
        *(f"within {each:g}" for each in within),
        "median flux",
        "least flux",
        "flux at worst",
    )
    for each in lights.lights:
        drawn = each.combinations
        table.add_row(
            LIGHTS[each.light],
            f"{np.median(drawn.percent):.2f}",
            f"{drawn.worst_percent:.2f}",
            f"{each.worst.percent:.2f}",
            *(_percent(*share).removesuffix(" %") for share in drawn.shares),
            f"{np.median(each.flux):.3f}",
            f"{each.flux.min():.3f}",
            f"{each.flux_at_worst:.3f}",
        )
    difference = lights.difference
    if difference is not None:
        table.add_row(
            "frozen - anew",
            f"{difference.median_percent:+.2f}",
            "",
            f"{difference.worst_percent:+.2f}",
            *(f"{100.0 * share:+.1f}({100.0 * error:.1f})" for share, error in difference.shares),
            f"{difference.median_flux:+.3f}",
            f"{difference.least_flux:+.3f}",
            "",
        )
    return table


def _print_item(console: Console, text: str) -> None:
    lines = textwrap.wrap(text, max(40, min(console.width, 120) - 2), initial_indent="- ", subsequent_indent="  ")
    console.print("\n".join(lines), markup=False, soft_wrap=True)


def as_dict(result: StudyResult) -> dict[str, Any]:
    """The result for JSON: values in deg or mm, criteria in percent, shares of 1."""
    recentred, uniformity = result.recentred, result.uniformity
    found = {
        "simulated": True,
        "name": result.study.name,
        "paper": PAPER.get(result.study.paper or 0),
        "criterion": result.study.criterion.model_dump(),
        "cases": [_case_as_dict(case) for case in result.cases],
        "yields": {name: _combinations_as_dict(drawn) for name, drawn in result.yields.items()},
        "sensitivities": None
        if result.sensitivities is None
        else [
            {"deviation": each.title, "unit": each.unit, "peak_deg": peak, "incidence_deg": incidence, "place_mm": place}
            for each, peak, incidence, place in zip(
                result.case.parameters, *(row.tolist() for row in vars(result.sensitivities).values()), strict=True
            )
        ],
        "recentred": None
        if recentred is None
        else {
            "aligned_percent": recentred.aligned_percent,
            "at_worst_percent": recentred.at_worst_percent,
            "peak_at_worst_deg": recentred.peak_at_worst_deg,
            "worst_percent": recentred.worst.percent,
            "limitations": recentred.limitations,
        },
        "uniformity": None if uniformity is None else {**vars(uniformity), "by_rays": vars(uniformity.by_rays)},
        "illumination": None if result.lights is None else _lights_as_dict(result.lights),
        "assumptions": assumptions(result),
        "explanations": explanations(result),
    }
    return {name: _without_infinities(each) for name, each in found.items()}


def _without_infinities(value: Any) -> Any:
    """A value for JSON: numbers that are not finite, of combinations without light, are None."""
    if isinstance(value, dict):
        return {name: _without_infinities(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_infinities(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _case_as_dict(case: Case) -> dict[str, Any]:
    return {
        "name": case.name,
        "aligned_percent": case.aligned_percent,
        "deviations": [
            {
                "element": each.element,
                "deviation": each.component,
                "limit": each.limit,
                "at_minus_percent": float(case.alone.percent[k, 0]),
                "at_plus_percent": float(case.alone.percent[k, 1]),
                "alone": case.alone.permitted[k].tolist(),
                "searched_to": float(case.alone.largest[k]),
                "common": float(case.common.limits[k]),
                "individual": float(case.individual.limits[k]),
                "at_worst": float(case.worst_values[k]),
            }
            for k, each in enumerate(case.parameters)
        ],
        "worst_percent": case.worst.percent,
        "worst_linear_percent": case.worst.linear_percent,
        "worst_evaluated": case.worst.evaluated,
        "common_factor": case.common.factor,
        "combinations": _combinations_as_dict(case.combinations),
    }


def _lights_as_dict(lights: LightComparison) -> dict[str, Any]:
    difference = lights.difference
    return {
        "frozen_unit": {
            "change_of_flux_percent": lights.frozen.percent,
            "relative_flux": lights.frozen_flux,
            "deviations": [
                {"element": each.element, "deviation": each.component, "value": float(level * each.limit)}
                for each, level in zip(lights.parameters, lights.frozen.levels, strict=True)
            ],
        },
        "lights": [
            {
                "light": each.light,
                "combinations": _combinations_as_dict(each.combinations),
                "worst_percent": each.worst.percent,
                "worst_levels": each.worst.levels.tolist(),
                "median_flux": float(np.median(each.flux)),
                "least_flux": float(each.flux.min()),
                "flux_at_worst": each.flux_at_worst,
            }
            for each in lights.lights
        ],
        "frozen_minus_anew": None if difference is None else vars(difference),
    }


def _combinations_as_dict(drawn: Combinations) -> dict[str, Any]:
    return {
        "number": drawn.percent.size,
        "complete": drawn.complete,
        "surrogate_error_percent": drawn.surrogate_error_percent,
        "median_percent": float(np.median(drawn.percent)),
        "worst_percent": float(drawn.worst_percent),
        "within": [
            {"percent": limit, "share": share, "standard_error": error}
            for limit, (share, error) in zip(drawn.within, drawn.shares, strict=True)
        ],
    }


def _or_nan(value: Any) -> float:
    return float(value) if math.isfinite(value) else math.nan


def write_report(result: StudyResult, folder: Path, stem: str) -> dict[str, str]:
    """Write figures and tables into a folder; their paths by name. Raises UserError."""
    paths = {"figure": folder / f"{stem}.png"}
    write_figures(result, paths["figure"], quantity(result))
    paths["elements"] = folder / f"{stem}-elements.png"
    write_elements(result, paths["elements"])
    heading = [
        f"SIMULATED: {result.study.name} (paper, section 3.3), computed with the virtual prototype; nothing is measured",
        *(f"{topic}: {text}" for topic, text in assumptions(result).items()),
    ]
    tables = {"deviations": _deviation_columns(result), "combinations": _combination_columns(result)}
    if result.recentred is not None:
        tables["limitations"] = {
            name: np.array([vars(each)[name] for each in result.recentred.limitations])
            for name in ("name", "unit", "limit", "worst", "factor")
        }
    if result.lights is not None:
        tables["illumination"] = _light_columns(result.lights)
    for name, columns in tables.items():
        paths[name] = folder / f"{stem}-{name}.csv"
        write_content(paths[name], Holds.COLUMNS, PointStream(heading, [columns]))
    return {name: str(path) for name, path in paths.items()}


def _deviation_columns(result: StudyResult) -> dict[str, Any]:
    """One row for each case and deviation."""
    paper = PAPER.get(result.study.paper or 0, {})
    rows = [(case, k, each) for case in result.cases for k, each in enumerate(case.parameters)]
    columns = {
        "case": [case.name or "study" for case, _, _ in rows],
        "element": [each.element for _, _, each in rows],
        "deviation": [each.name for _, _, each in rows],
        "unit": [each.unit for _, _, each in rows],
        "paper": [paper.get(each.unit, math.nan) for _, _, each in rows],
        "limit": [each.limit for _, _, each in rows],
        "at_minus_percent": [_or_nan(case.alone.percent[k, 0]) for case, k, _ in rows],
        "at_plus_percent": [_or_nan(case.alone.percent[k, 1]) for case, k, _ in rows],
        **{
            f"alone_{limit:g}_percent": [_or_nan(case.alone.permitted[k, column]) for case, k, _ in rows]
            for column, limit in enumerate(result.case.combinations.within)
        },
        "common": [case.common.limits[k] for case, k, _ in rows],
        "individual": [case.individual.limits[k] for case, k, _ in rows],
        "worst_combination": [case.worst_values[k] for case, k, _ in rows],
    }
    return {name: np.array(values) for name, values in columns.items()}


def _combination_columns(result: StudyResult) -> dict[str, Any]:
    """The distribution of the criterion: for each set of combinations the share of those within each of 200 values."""
    sets = [*((case.name or "study", case.combinations) for case in result.cases)]
    sets += [(f"yield {name}", drawn) for name, drawn in result.yields.items()]
    sets += [(f"light {each.light}", each.combinations) for each in (() if result.lights is None else result.lights.lights)]
    names, percents, shares = [], [], []
    for name, drawn in sets:
        values = np.sort(drawn.percent)
        edges = np.linspace(0.0, values[np.isfinite(values)].max(initial=0.0), CELLS + 1)[1:]
        names.append(np.repeat([name], CELLS))
        percents.append(edges)
        shares.append(np.searchsorted(values, edges, side="right") / values.size)
    return {"set": np.concatenate(names), "criterion_percent": np.concatenate(percents), "share_within": np.concatenate(shares)}


def _light_columns(lights: LightComparison) -> dict[str, Any]:
    """One row for each light, and their difference."""
    rows: list[tuple[str | float, ...]] = [
        (
            each.light,
            float(np.median(each.combinations.percent)),
            each.combinations.worst_percent,
            each.worst.percent,
            *each.combinations.shares[0],
            float(np.median(each.flux)),
            float(each.flux.min()),
            each.flux_at_worst,
        )
        for each in lights.lights
    ]
    difference = lights.difference
    if difference is not None:
        criteria = (difference.median_percent, math.nan, difference.worst_percent, *difference.shares[0])
        rows.append(("frozen minus anew", *criteria, difference.median_flux, difference.least_flux, math.nan))
    names = (
        "light",
        "median_percent",
        "worst_drawn_percent",
        "worst_found_percent",
        "share_within",
        "standard_error",
        "median_flux",
        "least_flux",
        "flux_at_worst",
    )
    return {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
