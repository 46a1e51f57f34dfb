"""Tolerance studies for the window: what a study file has, and its computation in a worker. No Qt.

The worker does what `goniotwin tolerances` does, and passes the numbers on without the arrays they come from, with the files
that the command would write. It ends with its study. While a run is in progress it waits at its next step.
"""

import io
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from goniotwin.app.desktop.model.worker import NotWanted, OneAtATime, WorkFailed, answer_of
from goniotwin.app.formats.file import make_folder, write_file
from goniotwin.app.json_document import json_text
from goniotwin.app.simulation.tolerances.study import (
    LIGHTS,
    GaussianTable,
    StudyFile,
    levels_of_parameters,
    parameters_of,
    read_study,
)

if TYPE_CHECKING:  # these load matplotlib, which the window does without
    from goniotwin.app.simulation.tolerances.result import Case, StudyResult
    from goniotwin.app.simulation.tolerances.stages import Combinations

CELLS = 200
"""Number of values at which a distribution is given."""
TEXT_COLUMNS = 100
"""Width of the text of a result."""
FEW = 4
"""Names of a list that are given one by one."""


@dataclass(frozen=True)
class StudyContent:
    """A study file as it is shown before it is computed: topics in words, and its deviations with range and step as text."""

    path: Path
    name: str
    topics: tuple[tuple[str, str], ...]
    deviations: tuple[tuple[str, str, str], ...]


@dataclass(frozen=True)
class DeviationResult:
    """One deviation in deg or mm: the criterion at both limits in percent, and the limits found.

    `alone` is that of the deviation alone, infinite where it passes up to `searched`; `common` and `individual` are those of
    all together. The sensitivities are changes by a deviation of 1 deg or 1 mm; without a lobe there are none.
    """

    title: str
    unit: str
    limit: float
    step: float
    at_minus_percent: float
    at_plus_percent: float
    alone: float
    searched: float
    common: float
    individual: float
    peak_deg: float | None = None
    incidence_deg: float | None = None
    place_mm: float | None = None

    @property
    def percent(self) -> float:
        """The larger criterion of the two limits."""
        return max(self.at_minus_percent, self.at_plus_percent)


@dataclass(frozen=True)
class Distribution:
    """The criterion over a set of combinations: the study, a variant, or a yield.

    `shares` are by limit of the criterion: limit in percent, share of 1 and standard error. `cumulative` has the share within
    each of `CELLS` equal steps up to `largest_percent`. `aligned`, `alone`, `worst` (by search) and `factor` are those of a
    study or a variant. `surrogate_error_percent` is the measured error of a surrogate in percentage points, if that was used.
    """

    name: str
    number: int
    complete: bool
    median_percent: float
    worst_percent: float
    shares: tuple[tuple[float, float, float], ...]
    largest_percent: float
    cumulative: tuple[float, ...]
    aligned_percent: float | None = None
    alone_percent: float | None = None
    factor: float | None = None
    surrogate_error_percent: float | None = None


@dataclass(frozen=True)
class StudyOutcome:
    """A computed study: its deviations, its distributions (the study first), a summary, the text and the files by name."""

    name: str
    quantity: str
    within: tuple[float, ...]
    deviations: tuple[DeviationResult, ...]
    distributions: tuple[Distribution, ...]
    summary: str
    text: str
    files: dict[str, bytes]


@dataclass(frozen=True)
class StudyProgress:
    """The share of a study that is done, from 0 to 1, and the step; `waiting` for the end of a run."""

    share: float
    step: str
    waiting: bool = False


@dataclass(frozen=True)
class Wait:
    """The request to wait at the next step, or no longer."""

    wanted: bool


StudyAnswer = StudyProgress | StudyOutcome | WorkFailed


def read_content(path: Path) -> StudyContent:
    """What a study file has. Raises UserError."""
    study = read_study(path)
    parameters = parameters_of(study.of_variant(None), study.instrument.instrument())
    deviations = tuple((each.title, f"±{each.limit:g} {each.unit}", f"{each.step:g} {each.unit}") for each in parameters)
    levels = math.prod(each.size for each in levels_of_parameters(parameters))
    return StudyContent(path, study.name, tuple(_topics(study, levels)), deviations)


def _topics(study: StudyFile, levels: int) -> Iterable[tuple[str, str]]:
    criterion, table = study.criterion, study.instrument
    limits = " or ".join(f"{each:g} %" for each in criterion.within_percent)
    if isinstance(criterion, GaussianTable):
        form = "1/e" if criterion.form == "one_over_e" else "half"
        sigmas = ", ".join(f"{each:g}" for each in criterion.sigma_deg)
        where = "plane of incidence" if criterion.directions == "plane" else "whole lobe"
        yield "Criterion", f"relative RMS of formula 5 within {limits}"
        yield "Sample", f"Gaussian of {criterion.width_deg:g}° ({form})"
        reach = f"θ up to {criterion.widths * criterion.width_deg:g}° in steps of {criterion.step_deg:g}°"
        yield "Directions", f"σ {sigmas}°, {where}, {reach}"
        pupil = f"pupil of {table.pupil_radius_mm:g} mm at {table.pupil_distance_mm:g} mm"
        yield "Light", "collimated" if table.collimated else pupil
    else:
        yield "Criterion", f"flux into the central 5 × 5 mm within {limits} of that without deviations"
        yield "Estimator", f"quadrature; the worst corner by {criterion.rays:,} rays as well"
    drawn = study.combinations
    if levels <= drawn.enumerate_up_to:
        how = ", by a surrogate" if drawn.evaluator == "surrogate" else ""
        yield "Combinations", f"all {levels:,} of the steps{how}"
    else:
        yield "Combinations", f"{drawn.draws:,} random corners"
    if study.yields.distributions:
        yield "Yields", f"{', '.join(study.yields.distributions)}; {study.yields.draws:,} instruments each"
    if study.illumination is not None:
        lights, draws = " and ".join(study.illumination.light), study.illumination.draws
        yield "Illumination", f"{lights}; {draws:,} combinations each"
    if study.variants:
        yield "Variants", "; ".join(each.name for each in study.variants)
    if study.paper is not None:
        yield "Paper", f"Table {study.paper}"


def write_outcome(outcome: StudyOutcome, folder: Path) -> None:
    """Write the files of an outcome into a folder, which is created. Raises UserError."""
    make_folder(folder)
    for name, content in outcome.files.items():
        write_file(folder / name, content)


# The worker.


def serve_study(connection: "Connection[Any, Any]") -> None:
    """Compute one study, whose path is the first request; its answers are `StudyAnswer`."""
    path: Path = connection.recv()
    waiting = False

    def report(share: float, step: str) -> None:
        nonlocal waiting
        connection.send(StudyProgress(share, step))
        while waiting or connection.poll():
            request = connection.recv()
            if request is None:
                raise NotWanted
            waiting = request.wanted
            connection.send(StudyProgress(share, step, waiting))

    connection.send(answer_of(lambda: compute_outcome(path, report), WorkFailed))


def compute_outcome(path: Path, report: Callable[[float, str], None]) -> StudyOutcome:
    """Compute the study of a file. Raises UserError, and whatever `report` raises."""
    # Loads 262 modules, matplotlib and rich among them: 0.6 s, which the window's first picture does without.
    from rich.console import Console

    from goniotwin.app.simulation.tolerances.report import as_dict, print_study, quantity, write_report
    from goniotwin.app.simulation.tolerances.result import compute_study

    result = compute_study(read_study(path), report)
    report(1.0, "figure and tables")
    text = io.StringIO()
    print_study(Console(file=text, width=TEXT_COLUMNS, highlight=False), result)
    with TemporaryDirectory() as folder:
        written = {name: Path(file) for name, file in write_report(result, Path(folder), path.stem).items()}
        files = {each.name: each.read_bytes() for each in written.values()}
    answer = {"file": str(path), **as_dict(result), "files": {name: each.name for name, each in written.items()}}
    files[f"{path.stem}.txt"] = text.getvalue().encode()
    files[f"{path.stem}.json"] = json_text(answer).encode()
    return StudyOutcome(
        name=result.study.name,
        quantity=quantity(result),
        within=result.case.combinations.within,
        deviations=tuple(_deviation_results(result)),
        distributions=tuple(_distributions(result)),
        summary=_summary(result),
        text=text.getvalue(),
        files=files,
    )


def _deviation_results(result: "StudyResult") -> Iterable[DeviationResult]:
    case, slopes = result.case, result.sensitivities
    for k, each in enumerate(case.parameters):
        minus, plus = case.alone.percent[k].tolist()
        rows = () if slopes is None else (slopes.peak_deg, slopes.incidence_deg, slopes.place_mm)
        permitted, largest = float(case.alone.permitted[k, 0]), float(case.alone.largest[k])
        limits = float(case.common.limits[k]), float(case.individual.limits[k])
        found = (each.title, each.unit, each.limit, each.step, minus, plus, permitted, largest, *limits)
        yield DeviationResult(*found, *(float(row[k]) for row in rows))


def _distributions(result: "StudyResult") -> Iterable[Distribution]:
    for case in result.cases:
        yield _distribution(case.name or f"{len(case.parameters)} deviations", case.combinations, case)
    for name, drawn in result.yields.items():
        yield _distribution(f"yield, {name}", drawn)
    for each in () if result.lights is None else result.lights.lights[2:]:
        found = _distribution(f"illumination {LIGHTS[each.light]}", each.combinations)
        yield replace(found, worst_percent=each.worst.percent)


def _distribution(name: str, drawn: "Combinations", case: "Case | None" = None) -> Distribution:
    values = np.sort(drawn.percent)
    largest = float(values[np.isfinite(values)].max(initial=0.0))
    shares = np.searchsorted(values, np.linspace(0.0, largest, CELLS + 1)[1:], side="right") / values.size
    limits = tuple((limit, share, error) for limit, (share, error) in zip(drawn.within, drawn.shares, strict=True))
    return Distribution(
        name=name,
        number=values.size,
        complete=drawn.complete,
        median_percent=float(np.median(values)),
        worst_percent=drawn.worst_percent if case is None else case.worst.percent,
        shares=limits,
        largest_percent=largest,
        cumulative=tuple(shares.tolist()),
        aligned_percent=None if case is None else case.aligned_percent,
        alone_percent=None if case is None else case.worst_alone[1],
        factor=None if case is None else case.common.factor,
        surrogate_error_percent=drawn.surrogate_error_percent,
    )


def _summary(result: "StudyResult") -> str:
    """What the study has found, in three or four short sentences."""
    case = result.case
    drawn, (worst_of, alone) = case.combinations, case.worst_alone
    within, (share, _) = drawn.within[0], drawn.shares[0]
    kind = "combinations" if drawn.complete else "random corners"
    parts = [
        f"Alone at most {percent_text(alone)} ({worst_of.title}).",
        f"Together {100.0 * share:.1f} % of {drawn.percent.size:,} {kind} are within {within:g} %: median "
        f"{percent_text(float(np.median(drawn.percent)))}, worst corner {percent_text(case.worst.percent)}.",
    ]
    if case.common.factor < 1.0:
        pairs = {(each.unit, each.limit): case.common.factor * each.limit for each in case.parameters}
        limits = " and ".join(f"±{value:.4f} {unit}" for (unit, _), value in list(pairs.items())[:FEW])
        parts.append(f"None fails within {case.common.factor:.3f} of the limits: {limits}.")
    else:
        parts.append("None fails within the limits.")
    if result.recentred is not None:
        parts.append(f"About the measured peak the worst corner is {percent_text(result.recentred.worst.percent)}.")
    if result.uniformity is not None:
        parts.append(
            f"The uniformity is {result.uniformity.aligned:.2f}, at the worst corner {result.uniformity.at_worst:.2f}."
        )
    return " ".join(parts).replace(" %", "\N{NO-BREAK SPACE}%")


def percent_text(value: float) -> str:
    """A criterion in percent as text; an instrument without a signal has none."""
    return f"{value:.2f} %" if math.isfinite(value) else "no value"


class Studies(OneAtATime[StudyAnswer]):
    """Computes one study at a time in a worker. `deliver` is called in a thread, with the number of a study and an answer."""

    def __init__(self, deliver: Callable[[tuple[int, StudyAnswer]], None], *, process: bool = True) -> None:
        super().__init__("tolerances", serve_study, deliver, StudyProgress, process=process)

    def compute(self, path: Path) -> None:
        """Begin a study, in place of one that is being computed; at once."""
        self.end()
        self.begin(path)

    def wait(self, wanted: bool) -> None:
        """Have the study wait at its next step, or go on."""
        self.put(Wait(wanted))
