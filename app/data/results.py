"""The results of a dataset by their light: values, and the panels that show them, alone and beside a second dataset."""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.components import words_of
from goniotwin.app.campaign.rehearsal.without_wires import expected_model, run_without_wires
from goniotwin.app.campaign.running.resume import recorded_rig
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.data.comparison import THEORY, LightComparison, compare, theory
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds import comparison, cuts, hemisphere, polar, spectrum
from goniotwin.app.data.kinds.choice import NEAR_PLANE_DEG, around_deg, band, cut_of_plane
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.values import SampleData
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import COVERAGE, Curve, curve_of
from goniotwin.app.figures.description import Map, Panel
from goniotwin.app.figures.hemisphere import PIXELS
from goniotwin.app.figures.surface import Surface, image_of, surface
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, TOLERANCE_DEG

Picture = Literal["plane", "cursor", "polar", "spectrum", "lobe"]
PREDICTION = "prediction"
PICTURES: tuple[Picture, ...] = get_args(Picture)
"""Beside the map: the plane of incidence, the plane through normal and cursor, the polar diagram, the spectrum at the cursor,
the lobe in space (which the map's surface is)."""


class Light(NamedTuple):
    """The light of some values: what there is to choose. `colour` is a wavelength or the name of a channel, as text."""

    sample: str
    colour: str
    side: str
    direction: str
    sigma_deg: float
    psi_deg: float


class View(NamedTuple):
    """What is to be shown: a light, a picture beside its map, the place of the cursor in the map, and what it is compared with.

    `other` is a file, THEORY for the model of a virtual rig's sample, PREDICTION for what its twin measures, or None.
    """

    light: Light
    picture: Picture = "plane"
    cursor: tuple[float, float] | None = None
    other: Path | str | None = None


@dataclass(frozen=True, eq=False)
class Shown:
    """The values (n,) of a view's light with the ends of their `band`, and the panels: `disc`, `beside` and `residual`.

    Without the panel beside, `missing` is the reason. A cut is in the plane at `plane_deg`, its azimuth from the light's, and
    has the values `plane` (m,) by growing `abscissa`. `image` are the shares of the bar over the map, and `surface` its
    triangles, None where the directions span no area. Only a journal has the numbers of its rows, and standard uncertainties
    by the words of each component. Compared with another dataset, `compared` (3, n) are its values, their u and z, NaN where
    it has none; `about` has chi-square, or why there is no comparison.
    """

    view: View
    data: SampleData
    band: tuple[Floats, Floats]
    disc: Panel
    image: Floats | None
    surface: Surface | None
    beside: Panel | None
    missing: str
    plane_deg: float
    plane: Ints
    abscissa: Floats
    row: Ints | None
    components: dict[str, Floats]
    residual: Panel | None = None
    compared: Floats | None = None
    about: str = ""

    @property
    def map(self) -> Map:
        """The values with their places."""
        assert self.disc.map is not None
        return self.disc.map

    @property
    def highest(self) -> int:
        """The index of the highest value to be trusted, by the lower end of its band: noise may be higher than the lobe."""
        lowest = np.where(np.isfinite(self.band[0]), self.band[0], self.data.values.values)
        return int(np.argmax(np.where(self.data.good, lowest, -np.inf)))

    def place(self, index: int) -> tuple[float, float]:
        """The place of a value in the map."""
        return float(self.map.x[index]), float(self.map.y[index])

    def nearest(self, x: float, y: float) -> int:
        """The index of the direction nearest to a place in the map, or of that whose image is."""
        return nearest_place(self.map, x, y)

    def towards(self, index: int, right: int, up: int) -> int:
        """The index of the nearest direction that is right or up of another one in the map; the same where there is none."""
        x, y = self.map.x - self.map.x[index], self.map.y - self.map.y[index]
        along, across = x * right + y * up, np.abs(x * up + y * right)
        there = np.flatnonzero((along > 1e-6) & (across <= along))
        return int(there[np.argmin(np.hypot(along, 2.0 * across)[there])]) if there.size else index

    def along_plane(self, index: int, step: int) -> int:
        """The index so many steps further in the cut; that of its nearest value for one that is not in it."""
        if not self.plane.size:
            return index
        there = np.flatnonzero(self.plane == index)
        x, y = self.map.x[self.plane] - self.map.x[index], self.map.y[self.plane] - self.map.y[index]
        at = int(there[0]) + step if there.size else int(np.argmin(np.hypot(x, y)))
        return int(self.plane[min(max(at, 0), self.plane.size - 1)])

    def in_plane_at(self, index: int, angle_deg: float) -> int:
        """The index of the value of the cut that is nearest to an abscissa; `index` where there is none."""
        return int(self.plane[np.argmin(np.abs(self.abscissa - angle_deg))]) if self.plane.size else index


def nearest_place(drawn: Map, x: float, y: float) -> int:
    """The index of the place nearest to one in a map; on a half that has images, of that whose image is nearest."""
    apart = (drawn.x - x) ** 2 + (drawn.y - y) ** 2
    return int(np.argmin(np.minimum(apart, (drawn.x - x) ** 2 + (drawn.y + y) ** 2) if drawn.mirrored else apart))


def first_light(lights: tuple[Light, ...]) -> Light:
    """The light to begin with: of the first sample, of the middle wavelength."""
    colours = list(dict.fromkeys(each.colour for each in lights if each.sample == lights[0].sample))
    return nearest_light(lights, lights[0], "colour", colours[len(colours) // 2])


def nearest_light(lights: tuple[Light, ...], like: Light, field: str, value: object) -> Light:
    """The light most like another one, of those with a value of a field if there are any: not every choice has all others."""

    def unlike(each: Light) -> tuple[bool, int, float]:
        others = sum(a != b for a, b in zip(each, like, strict=True))
        return getattr(each, field) != value, others, abs(each.sigma_deg - like.sigma_deg)

    return min(lights, key=unlike)


class Results:
    """The values of a dataset by their lights. Raises UserError for one without values, GoniotwinError for a second file."""

    def __init__(self, dataset: Dataset, path: Path | None = None) -> None:
        """The values of a dataset; `path` is its journal, for predictions."""
        self.dataset = dataset
        self._path = path
        self._indices: dict[Light, Ints] = {}
        self._other: tuple[Path | str, Dataset] | None = None
        for sample, data in dataset.data.items():
            for each in data.lights:
                colour = each.channel or ("" if math.isnan(each.wavelength_nm) else f"{each.wavelength_nm:g} nm")
                side, direction = "back" if each.back else "front", "transmitted" if each.transmitted else "reflected"
                self._indices[Light(sample, colour, side, direction, each.sigma_deg, each.psi_deg)] = each.index
        if not self._indices:
            raise UserError(f"{dataset.name}: no sample has values yet")

    @property
    def lights(self) -> tuple[Light, ...]:
        """The lights, of which there is at least one; last those without a trusted value, such as what a table fills."""
        return tuple(
            sorted(self._indices, key=lambda light: not self.dataset.data[light.sample].good[self._indices[light]].any())
        )

    def show(self, view: View) -> Shown:
        """The values and panels of a view. Raises UserError where no value is to be trusted."""
        here = self.dataset[view.light.sample].where(self._indices[view.light])
        if not here.good.any():
            raise UserError(f"{here.name}: no value of this light is to be trusted")
        disc = hemisphere.describe(here, None).panels[0]
        assert disc.map is not None
        at = (
            np.argmax(np.where(here.good, here.bsdf, -np.inf)) if view.cursor is None else nearest_place(disc.map, *view.cursor)
        )
        others, about = [], ""
        if view.other is not None:
            try:
                others = [self._compared(here, view.other)]
            except UserError as error:
                about = f"not compared: {error}"
        plane_deg, plane, x, panel, missing = self._beside(here, view, int(at), others)
        residual, compared = None, None
        for name, found in others:
            disc, residual = comparison.describe_light(found, here, plane, x)
            compared = np.full((3, here.size), math.nan)
            compared[:, found.index] = found.second, found.u_second, found.z
            about = f"blue: this file; orange: {name}; {found}"
        drawn = disc.map
        assert drawn is not None
        area = surface(drawn)
        measured = here.only.measured
        budget = {} if measured is None else measured.points.budget
        return Shown(
            view,
            replace(here.only, measured=None),
            band(here),
            disc,
            None if area is None else image_of(area, drawn.bar.scale.share(area.values, drawn.bar.limits), PIXELS),
            area,
            panel,
            missing,
            plane_deg,
            plane,
            x,
            None if measured is None else measured.points.row,
            {words_of(name): each for name, each in budget.items()},
            residual if plane.size else None,
            compared,
            about,
        )

    def _beside(
        self, here: Dataset, view: View, at: int, others: Sequence[tuple[str, LightComparison]]
    ) -> tuple[float, Ints, Floats, Panel | None, str]:
        """The picture beside the map, with the values of the cut and its abscissa; or the reason why there is none."""
        none = 0.0, np.zeros(0, dtype=np.int64), np.zeros(0)
        try:
            if view.picture == "lobe":
                return *none, None, ""
            if view.picture == "polar":
                figure = polar.describe(here, None)
                return *none, replace(_of_one_curve(figure.panels[0]), legend=figure.legend), ""
            if view.picture == "spectrum":
                return *none, _of_one_curve(self._spectrum(here, view.light, at)), ""
            turn = float(around_deg(here)[at]) % HALF_TURN_DEG if view.picture == "cursor" else 0.0
            in_it = here.polar_deg[at] < NEAR_PLANE_DEG or min(turn, HALF_TURN_DEG - turn) < TOLERANCE_DEG
            plane_deg = 0.0 if in_it else turn
            plane, x = cut_of_plane(here, plane_deg)
            curves = [(name, _second_curve(found, plane, x)) for name, found in others]
            return plane_deg, plane, x, cuts.describe_plane(here, plane, x, plane_deg, curves), ""
        except UserError as error:
            return *none, None, str(error)

    def _spectrum(self, here: Dataset, light: Light, at: int) -> Panel:
        """The spectrum in the direction of a value."""
        like = [index for each, index in self._indices.items() if each._replace(colour=light.colour) == light]
        every = self.dataset[light.sample].where(np.concatenate(like))
        return spectrum.describe_at(every, float(here.theta_deg[at]), float(here.phi_deg[at]))

    def _compared(self, here: Dataset, other: Path | str) -> tuple[str, LightComparison]:
        """The name of another dataset, and the comparison. Raises UserError where they have nothing in common."""
        if other == THEORY:
            second = theory(here)
        else:
            if self._other is None or self._other[0] != other:
                self._other = None  # its memory is free for the next one
                self._other = other, predicted(self._path or Path()) if isinstance(other, str) else open_dataset(other)
            second = self._other[1]
            names = [here.sample] if here.sample in second.samples else list(second.samples)
            if len(names) > 1:
                raise UserError(f"{second.name}: has the samples {', '.join(names)}, and none is called {here.sample}")
            second = second[names[0]]
        (found,) = compare(here, second).lights
        return second.name, found


def predicted(journal: Path) -> Dataset:
    """What the twin of a journal's rig measures by its schedule, with noise of its own. Raises UserError without a twin."""
    with Journal.open(journal) as opened:
        schedule = parse_schedule(opened.value("schedule"), f"{journal} (schedule)")
        if schedule.file.certificate is not None:
            schedule = replace(schedule, certificate=opened.value("certificate"))
        plan = make_plan(schedule, recorded_rig(opened))
    with tempfile.TemporaryDirectory(prefix="goniotwin-prediction-") as folder:
        path = Path(folder) / "prediction.journal"
        run_without_wires(plan, path, expected_model(plan))
        return replace(open_dataset(path), name="prediction of the twin")


def _of_one_curve(panel: Panel) -> Panel:
    """A panel with one curve in the colour of measured values."""
    series = tuple(replace(each, colour="points") for each in panel.series)
    marks = tuple(replace(each, colour="points") for each in panel.marks)
    return replace(panel, series=series, marks=marks, arrows=tuple(replace(each, colour="points") for each in panel.arrows))


def _second_curve(found: LightComparison, plane: Ints, x: Floats) -> Curve:
    """The curve of the second dataset of a comparison, at the values of a cut."""
    at = np.full(max(int(plane.max(initial=0)), int(found.index.max())) + 1, -1)
    at[found.index] = np.arange(found.index.size)
    there = at[plane] >= 0
    k = at[plane[there]]
    y, margin = found.second[k], COVERAGE * found.u_second[k]
    return curve_of(x[there], y, (y - margin, y + margin))
