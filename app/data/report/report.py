"""The report of a journal: what was measured, on what, how, with which uncertainty; plots, checks, faults, metadata, digest.

One HTML file that needs no other, or the same as a PDF. All texts of the journal are escaped: its origin may be unknown.
"""

import base64
import math
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.components import ADDED, interval_rule, words_of
from goniotwin.app.campaign.reduction.components import COVERAGE as INTERVAL_U
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.lit_hole import in_one_line
from goniotwin.app.campaign.reduction.points import FLAGS
from goniotwin.app.campaign.studies.budget import effective_degrees_of_freedom, finite, freedom_of, lines_of
from goniotwin.app.campaign.studies.closure import ClosureReport, signed
from goniotwin.app.campaign.studies.decades import (
    UPPER_DECADES,
    UncertaintyByDecade,
    decades_below_peak,
    uncertainty_texts,
)
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.verification import Verdict, verify_journal
from goniotwin.app.campaign.wording import key_text
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds import KINDS
from goniotwin.app.data.kinds.choice import side_words
from goniotwin.app.data.opening import dataset_of_evaluation
from goniotwin.app.data.plotting import plot
from goniotwin.app.data.standard_values import standard_values
from goniotwin.app.data.values import Measured
from goniotwin.app.errors import MissingPackage, UserError
from goniotwin.app.figures.curves import COVERAGE
from goniotwin.app.figures.matplotlib_figure import picture
from goniotwin.app.formats.content import UNTRUSTED
from goniotwin.app.formats.file import SQLITE, Replaceable, check_writable, read_head, write_file
from goniotwin.app.formats.metadata import Metadata
from goniotwin.protocols.clock import calendar_stamp, local_stamp

T = TypeVar("T")
TEMPLATE = "report.html.j2"
EVENTS = {
    "fault": "faults",
    "answer": "answers of the operator",
    "no operator": "faults without an operator",
    "order": "safety orders",
    "stop": "stops",
    "drift": "drift",
    "warm-up": "warm-up",
    "encoder": "encoders",
    "sleep": "sleep of the computer",
    "listener": "listeners",
    "guardian": "after the death of a program",
}
"""Kinds of events that a report has, with their headings."""
MOST_EVENTS, MOST_LIGHTS, MOST_LISTED, LEAST_SHARE = 30, 24, 24, 0.005
DIFFUSE_DEG = 30.0
"""Aspecular angle of the second value with a budget."""
STAMP = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:Z|[+-]\d\d:\d\d)")
"""A time in a text, as `calendar_stamp` has it."""
PDF, PAGES = ".pdf", (".html", ".htm")
"""The suffixes of a report."""
KIND = "BSDF measurement report"
OF_HEAD = ("date", "operator", "laboratory")
"""Metadata at the top of a report."""
PAGE = Replaceable("a report that goniotwin has written", lambda content: KIND.encode() in content)
NO_WEASYPRINT = "WeasyPrint is not installed; run pip install 'goniotwin[pdf]'"
NO_PANGO = (
    "Pango, which WeasyPrint needs, is not installed; on Debian and Ubuntu run sudo apt-get install -y libpango-1.0-0 "
    "libpangoft2-1.0-0 libharfbuzz-subset0, on macOS brew install pango, elsewhere see WeasyPrint's installation guide"
)


@dataclass(frozen=True)
class _Line:
    """A line of a budget: name, u in percent of the value, its share of u squared, what shares it and where it is from.

    `origin` is measured, stated or assumed; with the degrees of freedom, None where they are infinite.
    """

    name: str
    percent: float
    share: float
    shared_by: str = ""
    source: str = ""
    origin: str = ""
    freedom: float | None = None


def write_report(
    journal: Path,
    out: Path,
    *,
    without_damaged: bool = False,
    kinds: Collection[str] = KINDS,
    number: str = "",
    approved_by: str = "",
) -> dict[str, Any]:
    """Write the report of a journal, as `report_html`; returns what it states. The suffix .pdf makes a PDF.

    Raises UserError, and FormatError for `out`; MissingPackage where a PDF cannot be made: the HTML is then beside it.
    """
    as_pdf, page = out.suffix.lower() == PDF, out.with_suffix(PAGES[0])
    check_writable(out)
    if as_pdf:
        check_writable(page, PAGE)
    html, result = report_html(journal, without_damaged=without_damaged, kinds=kinds, number=number, approved_by=approved_by)
    try:
        content = pdf_of(html) if as_pdf else html.encode()
    except MissingPackage as error:
        write_file(page, html.encode(), PAGE)
        raise MissingPackage(f"{out}: {error}; the report is in {page} instead") from None
    write_file(out, content)
    return {"file": str(out), **result}


def pdf_of(html: str) -> bytes:
    """A report as PDF, by WeasyPrint; nothing is fetched. Raises MissingPackage with what to install."""
    try:
        weasyprint = import_module("weasyprint")
    except ImportError:
        raise MissingPackage(NO_WEASYPRINT) from None
    except OSError:  # it loads Pango as it is imported
        raise MissingPackage(NO_PANGO) from None
    document = weasyprint.HTML(string=html, url_fetcher=weasyprint.URLFetcher(allowed_protocols=("data",)))
    content: bytes = document.write_pdf()
    return content


def report_html(
    path: Path,
    *,
    without_damaged: bool = False,
    kinds: Collection[str] = KINDS,
    number: str = "",
    approved_by: str = "",
) -> tuple[str, dict[str, Any]]:
    """The report of a journal as HTML with pictures of `kinds`, and what it states in short, for JSON. Raises UserError.

    `number` is that of the report, on each page of print, and `approved_by` the person who authorises it.
    """
    template = _template()
    if read_head(path, len(SQLITE)) != SQLITE:
        raise UserError(f"{path}: is not a journal, and a report is one of a campaign; for a file use goniotwin plot")
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal, without_damaged=without_damaged)
        dataset = dataset_of_evaluation(evaluation)
        verdicts = verify_journal(evaluation)
        sessions = journal.sessions()
        done, planned = journal.row_counts()
        events = [(title, found) for kind, title in EVENTS.items() if (found := journal.event_texts(kind))]
        schedule, chain, seconds = journal.value("schedule"), journal.chain, journal.seconds
    rig = evaluation.reduction.rig
    metadata = {name: dataset[name].metadata for name in dataset}
    first = next(iter(metadata.values()), Metadata(title=dataset.name))
    reflectances = _reflectances(verdicts)
    html = template.render(
        title=first.title,
        name=dataset.name,
        simulated=dataset.simulated,
        seed=rig.seed if dataset.simulated else None,
        kind=KIND,
        number=number,
        head=[
            (name, text)
            for name, text in (
                ("report number", number),
                ("laboratory", first.laboratory),
                ("measured by", first.operator),
                ("approved by", approved_by),
                ("measured", first.date),
                ("report written", calendar_stamp()),
            )
            if text
        ],
        coverage=COVERAGE,
        metadata=list(_groups(first)),
        method=first.method,
        geometry=first.geometry,
        summary=_summary(dataset, verdicts),
        samples=[_sample(dataset[name], metadata[name], kinds) for name in dataset],
        verdicts=verdicts,
        reflectances=_spread(reflectances, MOST_LIGHTS),
        all_reflectances=len(reflectances),
        closure=_closure(evaluation.closure),
        rule=interval_rule("; ".join(map(words_of, sorted(ADDED)))),
        interval_u=INTERVAL_U,
        notes=dataset.notes,
        findings=dataset.findings,
        events=[(title, found[:MOST_EVENTS], max(0, len(found) - MOST_EVENTS)) for title, found in events],
        sessions=sessions,
        rows=(done, planned),
        seconds=seconds,
        chain=chain,
        schedule=schedule,
    )
    failed = [each.name for each in verdicts if each.verdict == "fails"]
    result = {
        "journal": str(path),
        "simulated": dataset.simulated,
        "samples": list(dataset.samples),
        "fails": failed,
        "findings": list(dataset.findings),
        "chain": chain.as_dict(),
        "damaged": sorted(chain.without_values),
    }
    return html, result


def _template() -> Any:
    """The template of the page."""
    environment = Environment(
        loader=PackageLoader("goniotwin.app.data", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        number=_number, percent=_percent, duration=_duration, signed=signed, local=_local, css=_css, words=words_of
    )
    return environment.get_template(TEMPLATE)


def _number(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.4g}"


def _percent(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{100.0 * value:.3g} %"


def _local(text: object) -> str:
    """A text with its times in this computer's time zone."""
    return STAMP.sub(lambda found: local_stamp(found[0]), str(text))


def _css(text: str) -> str:
    """A text within a string of a style sheet."""
    return "".join(each if each.isascii() and each.isalnum() else f"\\{ord(each):x} " for each in text)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


def _groups(metadata: Metadata) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """The metadata that are common to all samples, as headings with lines."""
    general: list[tuple[str, str]] = []
    groups: list[tuple[str, list[tuple[str, str]]]] = []
    for name, value in metadata.as_dict().items():
        if name in ("sample", *OF_HEAD):
            continue
        if isinstance(value, dict):
            groups.append((name, [(key_text(key), _text(each)) for key, each in value.items() if key != "findings"]))
        else:
            general.append((key_text(name), _text(value)))
    return iter([("campaign", general), *groups])


def _text(value: Any) -> str:
    if isinstance(value, list):
        if len(value) > MOST_LISTED and all(isinstance(each, int | float) for each in value):
            return f"{len(value)} from {_text(min(value))} to {_text(max(value))}"
        return ", ".join(map(_text, value))
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _summary(dataset: Dataset, verdicts: list[Verdict]) -> list[tuple[str, str]]:
    """The first lines of the report: what came out."""
    count = {word: sum(each.verdict == word for each in verdicts) for word in ("holds", "warns", "fails")}
    warned = f"{count['warns']} warn, " if count["warns"] else ""
    checks = (
        f"{count['holds']} hold, {warned}{count['fails']} fail, {len(verdicts) - sum(count.values())} without anything to judge"
    )
    values = []
    for name in dataset:
        here = dataset[name]
        known = UncertaintyByDecade()
        known.add(_measured(here).points)
        found = uncertainty_texts(known.summary()) or ["none of these above zero"]
        values += ["; ".join([f"{name}: {here.size} values, {int(here.good.sum())} of them trusted", *found])]
    return [*(("values", each) for each in values), ("checks", checks)]


def _measured(dataset: Dataset) -> Measured:
    measured = dataset.only.measured
    assert measured is not None  # it is a journal's
    return measured


def _clear(dataset: Dataset) -> np.ndarray:
    lost = _measured(dataset).points.flag("under-range")
    return np.asarray(dataset.good & ~lost & (dataset.bsdf > 0.0) & np.isfinite(dataset.u))


def _sample(dataset: Dataset, metadata: Metadata, kinds: Collection[str]) -> dict[str, Any]:
    """One sample's part of the report."""
    measured = dataset.only.measured
    counts = {} if measured is None else {name: int(measured.points.flag(name).sum()) for name in FLAGS}
    return {
        "name": dataset.sample,
        "about": [(key_text(key), value) for key, value in metadata.as_dict().get("sample", {}).items()],
        "plots": list(_plots(dataset, kinds)),
        "standard": standard_values(dataset),
        "lights": list(_lights(dataset)),
        "flags": [(name, FLAGS[name].meaning, count, name in UNTRUSTED) for name, count in counts.items() if count],
        "shares": _mean_shares(dataset),
        "budgets": list(_budgets(dataset)),
        "findings": metadata.quality.findings,
    }


def _plots(dataset: Dataset, kinds: Collection[str]) -> Iterator[tuple[str, str, str]]:
    """The pictures: kind, caption, and the picture itself as a data URI."""
    for kind in kinds:
        try:
            figure = plot(dataset, kind)
        except UserError:  # nothing to draw: one wavelength, no value
            continue
        form, media = ("png", "image/png") if kind == "hemisphere" else ("svg", "image/svg+xml")  # a map is pixels anyway
        yield kind, KINDS[kind], f"data:{media};base64,{base64.b64encode(picture(figure, form, 160)).decode()}"


def _lights(dataset: Dataset) -> Iterator[dict[str, Any]]:
    """By the light: number of values and relative uncertainties; of many wavelengths by sigma alone."""
    nm = np.nan_to_num(dataset.wavelength_nm, nan=0.0)
    columns = [dataset.transmitted.astype(float), dataset.back.astype(float), nm, dataset.sigma_deg]
    columns = [np.round(each, 6) for each in columns]
    places, which = _distinct(columns)
    if len(places) > MOST_LIGHTS:
        columns[2] = np.zeros(dataset.size)
        places, which = _distinct(columns)
    good = dataset.good
    known = np.flatnonzero(good & (dataset.bsdf > 0.0))
    upper = np.zeros(dataset.size, dtype=bool)
    upper[known] = decades_below_peak(_measured(dataset).points.where(known), dataset.bsdf[known]) < UPPER_DECADES
    for k, (transmitted, back, wavelength, sigma) in enumerate(places):
        here = which == k
        trusted, above = here & good, here & upper
        relative = dataset.u[above] / dataset.bsdf[above]
        low, middle, high = np.quantile(relative, [0.05, 0.5, 0.95]).tolist() if relative.size else [math.nan] * 3
        yield {
            "light": side_words(bool(transmitted), bool(back)),
            "wavelength": f"{wavelength:g} nm" if wavelength else "all",
            "sigma": sigma,
            "values": int(here.sum()),
            "trusted": int(trusted.sum()),
            "above": relative.size,
            "low": low,
            "middle": middle,
            "high": high,
            "largest": float(np.max(dataset.bsdf[trusted], initial=0.0)),
        }


def _distinct(columns: Sequence[np.ndarray]) -> tuple[list[tuple[float, ...]], np.ndarray]:
    """The different rows of some columns, ascending, and which of them each row is. One column after the other is sorted."""
    code = np.zeros(columns[0].size, dtype=np.int64)
    for column in columns:
        there, which = np.unique(column, return_inverse=True)
        code = code * there.size + which.ravel()
    _, first, which = np.unique(code, return_index=True, return_inverse=True)
    return list(zip(*(column[first].tolist() for column in columns), strict=True)), which.ravel()


def _mean_shares(dataset: Dataset) -> list[_Line]:
    """The mean share of each component in the square of u, over the values above their noise, the largest first."""
    measured = dataset.only.measured
    clear = _clear(dataset)
    if measured is None or not clear.any():
        return []
    components = measured.points.components
    total = np.zeros(int(clear.sum()))
    for each in components.values():
        total += each[clear]
    shares = {name: float(np.mean(each[clear] / total)) for name, each in components.items()}
    relative = {name: float(np.median(np.sqrt(each[clear]) / dataset.bsdf[clear])) for name, each in components.items()}
    ordered = sorted(shares, key=lambda name: -shares[name])
    return [_Line(name, relative[name], shares[name]) for name in ordered if shares[name] >= LEAST_SHARE]


def _budgets(dataset: Dataset) -> Iterator[dict[str, Any]]:
    """The budgets of two values at the middle sigma and wavelength: the largest, and one beside the lobe."""
    measured = dataset.only.measured
    clear = np.flatnonzero(_clear(dataset))
    if measured is None or not clear.size:
        return
    for column in (dataset.wavelength_nm, dataset.sigma_deg):
        there = np.unique(column[clear])
        clear = clear[column[clear] == there[there.size // 2]]
    largest = int(clear[np.argmax(dataset.bsdf[clear])])
    beside = int(clear[np.argmin(np.abs(dataset.theta_deg[clear] - DIFFUSE_DEG))])
    for k in dict.fromkeys((largest, beside)):
        yield _budget(dataset, measured, k)


def _budget(dataset: Dataset, measured: Measured, k: int) -> dict[str, Any]:
    effects = effects_of(measured.points.where(np.array([k])), measured.settings)
    components = in_one_line(effects.budget(0))
    found = lines_of(components, freedom_of(measured.settings, measured.points.where(np.array([k]))))
    value, u = float(dataset.bsdf[k]), math.sqrt(math.fsum(each.u**2 for each in components))
    lines = [
        _Line(
            each.name,
            abs(each.u / value),
            each.u**2 / u**2,
            *(("no other value", "") if each.input is None else (each.input.shared_by, each.input.source)),
            line.origin,
            finite(line.degrees_of_freedom),
        )
        for line in found
        for each in (line.component,)
    ]
    shown = [each for each in lines if each.share >= LEAST_SHARE]
    place = (
        f"{dataset.wavelength_nm[k]:g} nm, sigma {dataset.sigma_deg[k]:g}, theta {dataset.theta_deg[k]:.4g}, "
        f"phi {dataset.phi_deg[k]:.4g} deg, photodiode {dataset.photodiode[k]}"
    )
    rest = math.sqrt(max(1.0 - math.fsum(each.share for each in shown), 0.0))
    return {
        "place": place,
        "value": value,
        "u": u,
        "relative": u / value,
        "lines": shown,
        "more": len(lines) - len(shown),
        "rest": rest,
        "freedom": finite(effective_degrees_of_freedom(found)),
    }


def _reflectances(verdicts: list[Verdict]) -> list[dict[str, Any]]:
    """The directional-hemispherical reflectances that the check of energy has computed."""
    return [each for verdict in verdicts for each in verdict.figures.get("reflectances", [])]


def _spread(every: Sequence[T], most: int) -> Sequence[T]:
    """All of a list, or of a long one so many, evenly spread, with the first and the last."""
    if len(every) <= most:
        return every
    return [every[k] for k in np.linspace(0, len(every) - 1, most).round().astype(int)]


def _closure(report: ClosureReport) -> dict[str, Any]:
    lines = [
        {
            "sigma": each.beam.scan.at_deg,
            "wavelength": each.wavelength_nm,
            "certified": each.certified,
            "absolute": each.absolute,
            "ratio": each.ratio,
            "u": each.u,
            "z": each.z,
            "word": each.word,
        }
        for each in report.closures
    ]
    field = "" if report.field is None else str(report.field)
    return {"verdict": report.verdict, "lines": lines, "field": field, "missing": [*report.not_planned, *report.missing]}
