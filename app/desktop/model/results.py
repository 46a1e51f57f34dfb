"""The results of a journal or a file: its lights, and the pictures and values of one of them, made by a worker. No Qt.

The worker keeps the dataset, so that the window needs little memory and never waits. A choice is a request to it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from goniotwin.app.campaign.reduction.components import OTHER, kinds
from goniotwin.app.campaign.reduction.points import FLAGS
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds import cuts, hemisphere
from goniotwin.app.data.kinds.choice import abscissa, band, is_in_plane
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.values import SampleData
from goniotwin.app.desktop.model.worker import Worker, WorkerEnded
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import COVERAGE
from goniotwin.app.figures.description import Map, Marks, Panel
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics import arc_direction, light_direction
from goniotwin.twin.optics.geometry.coordinates import zenith_and_azimuth

LARGEST, LEAST_SHARE = 5, 0.005
"""Components of a value that are named, and the least share of its u squared that is."""
ENDED = "the process that reads it was ended by another program, or memory was short; open it again"


class Light(NamedTuple):
    """The light of some values: what there is to choose. `colour` is a wavelength or the name of a channel, as text."""

    sample: str
    colour: str
    side: str
    direction: str
    sigma_deg: float
    psi_deg: float


@dataclass(frozen=True)
class Opened:
    """A file that is open: what it is in words, its remarks, and its lights, of which there is at least one."""

    number: int
    name: str
    about: str
    notes: tuple[str, ...]
    simulated: bool
    lights: tuple[Light, ...]


@dataclass(frozen=True, eq=False)
class Shown:
    """The values (n,) of a light, and the panels of their map and of their cut; without one `missing` is the reason.

    `band` are lower and upper ends. `plane` are the values in the plane of incidence, by growing `abscissa`. Only a journal has
    the numbers of its rows, and standard uncertainties by the words of each component.
    """

    number: int
    light: Light
    data: SampleData
    band: tuple[Floats, Floats]
    disc: Panel
    cut: Panel
    missing: str
    plane: Ints
    abscissa: Floats
    row: Ints | None
    components: dict[str, Floats]

    @property
    def map(self) -> Map:
        """The values with their places."""
        assert self.disc.map is not None
        return self.disc.map

    @property
    def highest(self) -> int:
        """The index of the highest value to be trusted."""
        return int(np.argmax(np.where(self.data.good, self.data.values.values, -np.inf)))

    def place(self, index: int) -> tuple[float, float]:
        """The place of a value in the map."""
        return float(self.map.x[index]), float(self.map.y[index])

    def nearest(self, x: float, y: float) -> int:
        """The index of the direction nearest to a place in the map."""
        return int(np.argmin((self.map.x - x) ** 2 + (self.map.y - y) ** 2))

    def towards(self, index: int, right: int, up: int) -> int:
        """The index of the nearest direction that is right or up of another one in the map; the same where there is none."""
        x, y = self.map.x - self.map.x[index], self.map.y - self.map.y[index]
        along, across = x * right + y * up, np.abs(x * up + y * right)
        there = np.flatnonzero((along > 1e-6) & (across <= along))
        return int(there[np.argmin(np.hypot(along, 2.0 * across)[there])]) if there.size else index

    def along_plane(self, index: int, step: int) -> int:
        """The index so many steps further in the plane of incidence; that of its nearest value for one that is not in it."""
        if not self.plane.size:
            return index
        there = np.flatnonzero(self.plane == index)
        x, y = self.map.x[self.plane] - self.map.x[index], self.map.y[self.plane] - self.map.y[index]
        at = int(there[0]) + step if there.size else int(np.argmin(np.hypot(x, y)))
        return int(self.plane[min(max(at, 0), self.plane.size - 1)])

    def in_plane_at(self, index: int, angle_deg: float) -> int:
        """The index of the value in the plane of incidence that is nearest to an abscissa; `index` where there is none."""
        return int(self.plane[np.argmin(np.abs(self.abscissa - angle_deg))]) if self.plane.size else index


@dataclass(frozen=True)
class ResultsFailed:
    """A file or a light without a result, and the reason in one line."""

    number: int
    reason: str


Answer = Opened | Shown | ResultsFailed
Request = tuple[int, Path | Light]
"""The number of the file, and the file to open, or the light of it to show."""


def first_light(lights: Sequence[Light]) -> Light:
    """The light to begin with: of the first sample, of the middle wavelength."""
    colours = list(dict.fromkeys(each.colour for each in lights if each.sample == lights[0].sample))
    return nearest_light(lights, lights[0], "colour", colours[len(colours) // 2])


def nearest_light(lights: Sequence[Light], like: Light, field: str, value: object) -> Light:
    """The light most like another one, of those with a value of a field if there are any: not every choice has all others."""

    def unlike(each: Light) -> tuple[bool, int, float]:
        others = sum(a != b for a, b in zip(each, like, strict=True))
        return getattr(each, field) != value, others, abs(each.sigma_deg - like.sigma_deg)

    return min(lights, key=unlike)


def value_texts(shown: Shown, index: int) -> tuple[str, str, str]:
    """A value in words: with U and flags; its direction in each coordinate system; its largest components."""
    column = shown.data.column
    value, u, low, high = (float(each[index]) for each in (column("bsdf"), column("u"), *shown.band))
    text = f"{value:.4g}" if math.isfinite(value) else "no value"
    if math.isfinite(value) and math.isfinite(u):
        text += f" ± {COVERAGE * u:.2g} 1/sr (k = {COVERAGE:g})"
        if not math.isclose(high - value, value - low, rel_tol=1e-6, abs_tol=1e-12):
            text += f", interval {low:.3g} to {high:.3g}"
    elif math.isfinite(value):
        text += " 1/sr, no uncertainty"
    flags = [f"{each}: {FLAGS[each].meaning}" if each in FLAGS else each for each in column("flags")[index].split()]
    polar, azimuth, theta, phi = (column(f"{name}_deg")[index] for name in ("polar", "azimuth", "theta", "phi"))
    half, difference = half_and_difference(shown.light.sigma_deg, polar, azimuth - shown.light.psi_deg)
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
    """Answer each `Request` by an `Answer`; of several requests that wait the latest alone."""
    results: Results | None = None
    while (request := connection.recv()) is not None:
        while request is not None and connection.poll():
            request = connection.recv()
        if request is None:
            return
        number, wanted = request
        try:
            if isinstance(wanted, Path):
                results = None  # its memory is free for the next one
                results = Results(open_dataset(wanted))
                answer: Answer = results.opened(number)
            else:
                assert results is not None
                answer = results.show(number, wanted)
        except UserError as error:
            answer = ResultsFailed(number, str(error))
        except MemoryError:
            answer = ResultsFailed(number, "there is too little memory for it")
        except Exception as error:  # noqa: BLE001  (of any library: reported, and the window goes on)
            answer = ResultsFailed(number, f"{type(error).__name__}: {error}")
        connection.send(answer)


class Results:
    """An open dataset, with its values by their lights. Raises UserError for one without values."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._indices: dict[Light, Ints] = {}
        for sample, data in dataset.data.items():
            for each in data.lights:
                colour = each.channel or ("" if math.isnan(each.wavelength_nm) else f"{each.wavelength_nm:g} nm")
                side, direction = "back" if each.back else "front", "transmitted" if each.transmitted else "reflected"
                self._indices[Light(sample, colour, side, direction, each.sigma_deg, each.psi_deg)] = each.index
        if not self._indices:
            raise UserError(f"{dataset.name}: no sample has values yet")

    def opened(self, number: int) -> Opened:
        """The file in words, and its lights."""
        of = self._dataset
        notes = (*of.findings, *of.notes)
        return Opened(number, of.name, f"{of.origin}, {of.size} values", notes, of.simulated, tuple(self._indices))

    def show(self, number: int, light: Light) -> Shown:
        """The pictures and values of a light. Raises UserError where none is to be trusted."""
        here = self._dataset[light.sample].where(self._indices[light])
        if not here.good.any():
            raise UserError(f"{here.name}: no value of this light is to be trusted")
        (disc,) = hemisphere.describe(here, None).panels
        plane, cut, missing = np.zeros(0, dtype=np.int64), Panel(), ""
        try:
            plane = np.flatnonzero(is_in_plane(here))
            (cut,) = cuts.describe(here, None).panels
        except UserError as error:
            missing = str(error)
        # One curve has the colour of measured values. Where there are few values, they have symbols on paper, and marks here.
        drawn = [(each, np.isfinite(each.y)) for each in cut.series if each.symbol is not None]
        few = [Marks("measured", each.x[there], each.y[there]) for each, there in drawn]
        cut = replace(
            cut,
            series=tuple(replace(each, colour="points") for each in cut.series),
            marks=(*few, *(replace(each, colour="points") for each in cut.marks)),
            guides=tuple(replace(each, colour="points") for each in cut.guides),
        )
        plane = plane[np.argsort(abscissa(here)[plane], kind="stable")]
        measured, of = here.only.measured, kinds()
        budget = {} if measured is None else measured.points.budget
        return Shown(
            number,
            light,
            replace(here.only, measured=None),
            band(here),
            disc,
            cut,
            missing,
            plane,
            abscissa(here)[plane],
            None if measured is None else measured.points.row,
            {of.get(name, OTHER).words or name: each for name, each in budget.items()},
        )


class ResultsReader:
    """Opens one file at a time in a worker. `deliver` is called in a thread with what `take` takes."""

    def __init__(self, deliver: Callable[[object], None], *, process: bool = True) -> None:
        self._deliver = deliver
        self._process = process
        self._worker: Worker | None = None
        self._opening = False
        self._number = 0

    def open(self, path: Path) -> None:
        """Open a file in place of the one that is open, or is being opened; return at once."""
        if self._opening:
            self.close()
        if self._worker is None:
            self._worker = Worker("results", serve_results, self._deliver, process=self._process)
        self._number, self._opening = self._number + 1, True
        self._worker.put((self._number, path))

    def show(self, light: Light) -> None:
        """Ask for the values of a light of the file."""
        if self._worker is not None:
            self._worker.put((self._number, light))

    def take(self, answer: object) -> Answer | None:
        """What was delivered, if it is about the file that was asked for last."""
        if isinstance(answer, WorkerEnded):
            self.close()
            answer = ResultsFailed(self._number, ENDED)
        assert isinstance(answer, Answer)
        if answer.number != self._number:
            return None
        self._opening = False
        return answer

    def close(self) -> None:
        """End the worker."""
        self._opening = False
        if self._worker is not None:
            worker, self._worker = self._worker, None
            worker.close()
