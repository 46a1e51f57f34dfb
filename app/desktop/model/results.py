"""The results of a journal or a file: what a worker has read, and the values in words. No Qt.

The worker keeps the dataset, so that the window needs little memory and never waits. A choice is a request to it.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from html import escape
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.kernels import call_kernels
from goniotwin.app.campaign.reduction.points import FLAGS
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.verification import Verdict, verdicts_text, verify_journal
from goniotwin.app.data.comparison import THEORY as THEORY
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.opening import open_in_parts
from goniotwin.app.data.results import PREDICTION as PREDICTION
from goniotwin.app.data.results import Light as Light
from goniotwin.app.data.results import Results, Shown
from goniotwin.app.data.results import View as View
from goniotwin.app.data.results import first_light as first_light
from goniotwin.app.data.results import nearest_light as nearest_light
from goniotwin.app.desktop.model.worker import ENDED, Worker, WorkerEnded, answer_of
from goniotwin.app.figures.curves import COVERAGE
from goniotwin.twin.optics import arc_direction, light_direction
from goniotwin.twin.optics.geometry.coordinates import zenith_and_azimuth

MOST_CHECKED = 100_000
"""Values of a journal up to which its verdicts are computed unasked: 4 s."""
WAIT_S = 1.0
"""Longest wait for the request to show what has been read first."""
LARGEST, LEAST_SHARE = 5, 0.005
"""Components of a value that are named, and the least share of its u squared that is."""


@dataclass(frozen=True)
class Opened:
    """A file that is open, or the first setting of a journal that is being read: in words, and its lights, at least one.

    `whole` is false of the latter. `check`: its verdicts take little time, so that they are computed unasked.
    """

    number: int
    name: str
    about: str
    notes: tuple[str, ...]
    simulated: bool
    journal: bool
    whole: bool
    check: bool
    lights: tuple[Light, ...]


class Check:
    """The request for the verdicts on the journal that is open."""


@dataclass(frozen=True)
class Checked:
    """The verdicts on a journal."""

    number: int
    verdicts: tuple[Verdict, ...]

    @property
    def summary(self) -> str:
        """Them in one line."""
        return verdicts_text(self.verdicts)

    @property
    def html(self) -> str:
        """All of them, a paragraph each, with what to do."""

        def paragraph(each: Verdict) -> str:
            name, text, remedy = map(escape, (f"{each.name}: {each.verdict}", each.text, each.remedy))
            return f"<p><b>{name}</b><br>{text}{f'<br><b>{remedy}</b>' if remedy else ''}</p>"

        return "".join(map(paragraph, self.verdicts))


@dataclass(frozen=True)
class Answered:
    """What a view shows."""

    number: int
    shown: Shown


@dataclass(frozen=True)
class ResultsFailed:
    """A file or a view without a result, and the reason in one line."""

    number: int
    reason: str


Answer = Opened | Checked | Answered | ResultsFailed
Request = tuple[int, Path | View | Check | None]
"""The number of the file, and the file to open, or what to show of it; None begins."""


def value_texts(shown: Shown, index: int) -> tuple[str, str, str]:
    """A value in words: with U and flags; its direction in each coordinate system; its largest components."""
    column, light = shown.data.column, shown.view.light
    value, u, low, high = (float(each[index]) for each in (column("bsdf"), column("u"), *shown.band))
    text = f"{value:.4g}" if math.isfinite(value) else "no value"
    if math.isfinite(value) and math.isfinite(u):
        text += f" ± {COVERAGE * u:.2g} 1/sr (k = {COVERAGE:g})"
        if not math.isclose(high - value, value - low, rel_tol=1e-6, abs_tol=1e-12):
            text += f", interval {low:.3g} to {high:.3g}"
    elif math.isfinite(value):
        text += " 1/sr, no uncertainty"
    if shown.compared is not None and math.isfinite(shown.compared[0, index]):
        second, _, z = shown.compared[:, index]
        text += f"; second {second:.4g} 1/sr" + (f", z = {z:+.2f}" if math.isfinite(z) else "")
    flags = [f"{each}: {FLAGS[each].meaning}" if each in FLAGS else each for each in column("flags")[index].split()]
    polar, azimuth, theta, phi = (column(f"{name}_deg")[index] for name in ("polar", "azimuth", "theta", "phi"))
    half, difference = half_and_difference(light.sigma_deg, polar, azimuth - light.psi_deg)
    parts = [
        f"polar angle {polar:.2f}°, azimuth {azimuth:.2f}°",
        f"θ {theta:.2f}°, φ {phi:.2f}°",
        f"half angle {half:.2f}°, difference angle {difference:.2f}°",
        *([f"row {shown.row[index]}"] if shown.row is not None else []),
        *([f"photodiode {column('photodiode')[index]}"] if column("photodiode")[index] >= 0 else []),
    ]
    shares = {name: (each[index] / u) ** 2 for name, each in shown.components.items()} if u > 0.0 else {}
    largest = sorted(shares.items(), key=lambda each: -each[1])[:LARGEST]
    named = ", ".join(f"{name} {100.0 * share:.0f}\u00a0%" for name, share in largest if share >= LEAST_SHARE)
    return f"{text}; {'; '.join(flags) or 'no flag'}", "; ".join(parts), f"Shares of u²: {named}" if named else ""


def half_and_difference(sigma_deg: float, polar_deg: float, around_deg: float) -> tuple[float, float]:
    """Polar angle of the half direction, and the angle between it and the light, deg.

    A transmitted direction counts as its image in the sample's plane, as theta does.
    """
    light, seen = light_direction(sigma_deg), arc_direction(polar_deg, around_deg)
    apart, together = (float(np.linalg.norm(each)) for each in (light - seen, light + seen))
    return float(zenith_and_azimuth(light + seen)[0]), math.degrees(math.atan2(apart, together))


# The worker.


def serve_results(connection: "Connection[Any, Any]") -> None:
    """Answer each `Request` by an `Answer`; of several alike that wait the latest alone. Read on while none waits."""
    work, waiting, number = _Work(), list[Request | None](), 0
    while True:
        while connection.poll() or not (waiting or work.steps):
            waiting.append(connection.recv())
        if None in waiting:
            return
        latest = {type(each[1]): each for each in waiting if each is not None}  # in the order of the first of each type
        number, wanted = latest.pop(next(iter(latest))) if latest else (number, None)
        waiting = list(latest.values())
        answer = answer_of(partial(work.do, number, wanted), partial(ResultsFailed, number))
        if answer is not None:
            connection.send(answer)
        if isinstance(answer, Opened) and not answer.whole:
            connection.poll(WAIT_S)  # what comes first is shown before the rest is read


class _Work:
    """What a worker has open; `steps` are left while the file is read."""

    def __init__(self) -> None:
        self.steps: Iterator[Dataset] | None = None
        self._path = Path()
        self._results: Results | None = None

    def do(self, number: int, wanted: Path | View | Check | None) -> Answer | None:
        """Answer a request, or read on."""
        if isinstance(wanted, View):
            assert self._results is not None
            return Answered(number, self._results.show(wanted))
        if isinstance(wanted, Check):
            with Journal.open(self._path) as opened:
                return Checked(number, tuple(verify_journal(evaluate_journal(opened))))
        if wanted is None and self.steps is None:  # the process has started: what each journal needs is loaded meanwhile
            call_kernels()
            return None
        if wanted is not None:
            self._results = None  # its memory is free for the next one
            self._path, self.steps = wanted, open_in_parts(wanted)
        assert self.steps is not None
        steps, self.steps = self.steps, None  # none are left after an error
        if (found := next(steps, None)) is None:
            return None
        self._results, self.steps = Results(found, self._path), steps
        notes, journal = (*found.findings, *found.notes), found.origin == "journal"
        whole = not journal or found.reduced is not None
        about = f"{found.origin}, {found.size} values{'' if whole else ' so far; the others are being read …'}"
        check = journal and whole and found.size <= MOST_CHECKED
        return Opened(number, found.name, about, notes, found.simulated, journal, whole, check, self._results.lights)


class ResultsReader:
    """Opens one file at a time in a worker. `deliver` is called in a thread with what `take` takes."""

    def __init__(self, deliver: Callable[[object], None], *, process: bool = True) -> None:
        self._deliver = deliver
        self._process = process
        self._worker: Worker | None = None
        self._opening = False
        self._number = 0

    def begin(self) -> None:
        """Start the worker, which takes a second or two, before a file is opened."""
        if self._worker is None:
            self._worker = Worker("results", serve_results, self._deliver, process=self._process)
            self._worker.put((self._number, None))

    def open(self, path: Path) -> None:
        """Open a file in place of the one that is open, or is being opened; return at once."""
        if self._opening:
            self.close()
        self.begin()
        assert self._worker is not None
        self._number, self._opening = self._number + 1, True
        self._worker.put((self._number, path))

    def check(self) -> None:
        """Ask for the verdicts on the journal that is open."""
        if self._worker is not None:
            self._worker.put((self._number, Check()))

    def show(self, view: View) -> None:
        """Ask for what a view shows of the file."""
        if self._worker is not None:
            self._worker.put((self._number, view))

    def take(self, answer: object) -> Answer | None:
        """What was delivered, if it is about the file that was asked for last."""
        if isinstance(answer, WorkerEnded):
            self.close()
            answer = ResultsFailed(self._number, ENDED)
        assert isinstance(answer, Answer)
        if answer.number != self._number:
            return None
        self._opening = isinstance(answer, Opened) and not answer.whole
        return answer

    def close(self) -> None:
        """End the worker."""
        self._opening = False
        if self._worker is not None:
            worker, self._worker = self._worker, None
            worker.close()
