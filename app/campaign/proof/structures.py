"""Drawn structures: random schedules with random samples, each by its number alone, as the texts of ordinary files.

A structure is what is chosen before a campaign: directions, incidences, wavelengths, gains, readings, cross-checks, and what
the samples are like. Its texts go through the parsers of schedule and rig file as any other, and a schedule that the planner
refuses is drawn again. Whatever it is: the law of its values is the one that is stated.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import tomlkit

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.app.rig.described_twin import described_twin
from goniotwin.twin.plant.noise import mix
from goniotwin.twin.plant.process_key import process_key

One = TypeVar("One")

MOST_STRUCTURES = 10_000
SEEDS = 1000
"""Seeds of the rigs of a structure: its number times this, and those that follow."""
MOST_DRAWN = 20
"""A structure is drawn again so often, where the planner refuses its schedule."""
ROWS = 96
"""Rows of samples and etalon at most, without cross-checks."""
LEAST_SCANNED_SIGMA_DEG = 10
ALIGNED = 0.5
"""Share of the schedules with a round lobe and another sample that are aligned by the lobe."""
ETALON = "etalon"
STEPS_DEG = (2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 30, 45)
CIRCLE_STEPS_DEG = (15, 30, 45, 45, 60, 90)
SHIFTS: tuple[list[float], ...] = ([0], [0, 2.5], [0, 1.25, 2.5, 3.75], [0, 1, 2, 3, 4], [0, 0.5, 1, 1.5, 2], [0.5, 3], [1])
SPECULAR_DEG = 180
"""Beta of the half plane of the specular direction."""
THINNED = 3
"""A grid of more values than a third of those of beta loses one first, where there are too many rows."""
SPECTRUM_NM = range(420, 681, 20)


@dataclass(frozen=True)
class Structure:
    """A structure by its number: its schedule, its rig file with the samples, and why earlier drawings were refused."""

    number: int
    schedule: ScheduleDescription
    rig: RigDescription
    refused: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The beginning of the names of its files."""
        return f"structure-{self.number:03d}"


def draw_structure(number: int, base: RigDescription) -> Structure:
    """Draw a structure for the rig of a file, with the drawn samples in place of the file's.

    Raises UserError where each of its drawings is refused.
    """
    refused: list[str] = []
    for attempt in range(MOST_DRAWN):
        gains = sorted(base.file.photodiodes.gains_v_per_a)
        aligned = _Random(number, f"alignment {attempt}").share() < ALIGNED
        drawn = _Drawing(_Random(number, f"drawing {attempt}"), number, gains, aligned)
        schedule = parse_schedule(drawn.schedule, f"structure {number}")
        rig = _with_samples(base, drawn.samples, SEEDS * number)
        try:
            make_plan(schedule, rig)
        except UserError as error:
            refused.append(str(error))
            continue
        return Structure(number, schedule, rig, tuple(refused))
    raise UserError(f"structure {number}: no drawing of {MOST_DRAWN} is possible on {base.name}, the last one: {refused[-1]}")


def _with_samples(base: RigDescription, samples: dict[str, str], seed: int) -> RigDescription:
    """The rig of a file with a seed, and with an ideal etalon and these samples alone."""
    twin = described_twin(base, ETALON, (), {}).rig
    document = tomlkit.parse(twin.text)
    level = min(1.0, base.file.etalon.radiance_factor)
    tables = {ETALON: f'model = "lambertian"\nside = "both"\nreflectance = {level!r}\n', **samples}
    del document["twin"]["samples"]
    document["simulated"]["seed"] = seed
    text = tomlkit.dumps(document) + "".join(f"\n[twin.samples.{name}]\n{each}" for name, each in tables.items())
    return parse_rig(text, base.folder, base.name, base.alignment)


class _Random:
    """Random numbers, each by the next number of a counter: they depend on seed, process and their order alone."""

    def __init__(self, seed: int, process: str) -> None:
        self._key, self._counter = process_key(seed, process), 0

    def share(self) -> float:
        """A number from 0 to 1."""
        self._counter += 1
        return float(mix(self._key, np.int64(self._counter))) / 2.0**64

    def choice(self, values: Sequence[One]) -> One:
        """One of the values."""
        return values[min(int(self.share() * len(values)), len(values) - 1)]

    def sample(self, values: Sequence[One], count: int) -> list[One]:
        """So many different ones of the values."""
        left = [*values]
        return [left.pop(left.index(self.choice(left))) for _ in range(count)]

    def between(self, low: float, high: float, digits: int = 2) -> float:
        """A number between two, with so many decimals."""
        return round(low + (high - low) * self.share(), digits)

    def width(self, low: float, high: float) -> float:
        """A number of the same probability in each decade, with three digits."""
        return float(f"{low * (high / low) ** self.share():.3g}")


@dataclass
class _Drawing:
    """One drawing: the texts of a schedule, and of samples by name."""

    random: _Random
    number: int
    gains_v_per_a: list[float]
    aligned: bool
    samples: dict[str, str] = field(default_factory=dict)
    schedule: str = ""

    def __post_init__(self) -> None:
        random = self.random
        self._light = random.choice(["reflected"] * 3 + ["transmitted"] * 2 + ["both"])
        self._side = random.choice(["front"] * 4 + ["back", "both"])
        anisotropic = random.share() < 0.4
        kinds = ["lobe", "lobe", "sum", "two lobes", "wide", "ward", "coloured", "diffuser"]
        chosen = [random.choice(kinds) for _ in range(random.choice([1, 1, 2]))]
        if anisotropic:
            chosen[0] = random.choice(["brushed", "brushed", "brushed sum", "anisotropic ward"])
        for kind in chosen:
            name = kind.replace(" ", "-")
            self.samples[f"{name}-2" if name in self.samples else name] = self._sample(kind)
        self.schedule = "".join(self._lines(anisotropic, chosen))

    def _sample(self, kind: str) -> str:
        """The table of a sample: with light "both", half of what it returns goes through it."""
        lobes: list[str] = []
        ways = {"reflected": [False], "transmitted": [True], "both": [False, True]}[self._light]
        for transmits in ways:
            lobes += self._lobes(kind, transmits, self.random.between(0.2, 0.9) / len(ways))
        listed = ",\n".join(f"    {{ {each} }}" for each in lobes)
        return f'model = "sum"\nlobes = [\n{listed},\n]\n'

    def _lobes(self, kind: str, transmits: bool, reflectance: float) -> Iterator[str]:
        """The lobes of a sample with a reflectance in all; a sum has a diffuse part, or a second lobe."""
        random = self.random
        through = 'side = "both", ' + ("transmits = true, " if transmits else "")
        share = self.random.between(0.05, 0.9)

        def lobe(part: float) -> str:
            width = self.random.width(0.5, 30.0)
            return f'model = "gaussian", {through}width_deg = {width}, reflectance = {part:.4f}'

        def diffuse(part: float, spectrum: str = "") -> str:
            own = f"reflectance = 0.0, transmittance = {part:.4f}" if transmits else f"reflectance = {part:.4f}"
            return f'model = "lambertian", side = "both", {own}{spectrum}'

        match kind:
            case "lobe":
                yield lobe(reflectance)
            case "sum":
                yield lobe(reflectance * share)
                yield diffuse(reflectance * (1.0 - share))
            case "two lobes":
                yield lobe(reflectance * share)
                yield lobe(reflectance * (1.0 - share))
            case "wide":
                width = self.random.width(0.5, 8.0)
                yield f'model = "wide-tailed", {through}width_deg = {width}, reflectance = {reflectance:.4f}'
            case "ward":
                alpha = self.random.width(0.03, 0.4)
                yield f'model = "ward", {through}alpha_x = {alpha}, alpha_y = {alpha}, reflectance = {reflectance:.4f}'
            case "coloured":
                yield diffuse(reflectance * (1.0 - share), self._spectrum())
                yield lobe(reflectance * share)
            case "diffuser":
                yield diffuse(reflectance)
            case "anisotropic ward":
                alpha, ratio = self.random.width(0.03, 0.2), self.random.between(1.3, 4.0)
                turn = random.choice(range(0, 180, 5))
                axes = f"alpha_x = {alpha}, alpha_y = {alpha * ratio:.4f}, direction_deg = {turn}"
                yield f'model = "ward", {through}{axes}, reflectance = {reflectance:.4f}'
            case _:
                along, ratio = self.random.width(1.0, 10.0), self.random.between(1.3, 5.0)
                turn = random.choice(range(0, 180, 5))
                axes = f"along_deg = {along}, across_deg = {along * ratio:.3f}, direction_deg = {turn}"
                part = reflectance * share if kind == "brushed sum" else reflectance
                yield f'model = "anisotropic-gaussian", {through}{axes}, reflectance = {part:.4f}'
                if kind == "brushed sum":
                    yield diffuse(reflectance * (1.0 - share))

    def _spectrum(self) -> str:
        """A rise or a fall between two levels, smooth over 60 to 250 nm."""
        middle, width = self.random.between(470, 630), self.random.between(15, 60)
        low, high = self.random.between(0.05, 0.4), self.random.between(0.6, 1.0)
        if self.random.share() < 0.3:
            low, high = high, low
        factors = [round(low + (high - low) / (1.0 + math.exp(-(each - middle) / width)), 4) for each in SPECTRUM_NM]
        return f", wavelengths_nm = {[*SPECTRUM_NM]}, factors = {factors}"

    def _lines(self, anisotropic: bool, kinds: list[str]) -> Iterator[str]:
        """The lines of the schedule."""
        random = self.random
        count = random.choice([1, 2, 2, 3])
        sigma = sorted(random.sample(range(86), count))
        beta = self._beta(anisotropic)
        shift = [*random.choice(SHIFTS)]
        gamma = sorted(random.sample(range(0, 360, 5), random.choice([1, 1, 2]))) if anisotropic else [0]
        several = [1, 2, 3, 4] if "coloured" in kinds else [1, 1, 2]
        wavelength = sorted(random.sample(range(440, 661, 5), random.choice(several)))
        # The arc has 36 photodiodes, so that few poses are many directions.
        passes = (len(kinds) + 1) * (2 if self._side == "both" else 1) * (2 if self._light == "both" else 1)
        grids: list[list[Any]] = [wavelength, gamma, shift, sigma]
        while passes * len(beta) * math.prod(map(len, grids)) > ROWS:
            longest = max(grids, key=len)
            if len(longest) > 1 and len(longest) * THINNED > len(beta):
                longest.remove(random.choice(longest))
            else:
                beta = beta[::2] if 0 in beta else beta[1:] if beta[-1] == SPECULAR_DEG else beta[1:-1]
        yield f"# Structure {self.number} of a proof: drawn schedule, and samples in the rig file of the same name.\n"
        yield f'name = "structure {self.number}"\nside = "{self._side}"\nlight = "{self._light}"\n'
        yield f'symmetry = "{"anisotropic" if anisotropic else "isotropic"}"\n'
        names = ", ".join(f'"{each}"' for each in self.samples)
        yield f'samples = [{names}]\netalon = "{ETALON}"\n'
        if self.aligned and "lobe" in self.samples and len(kinds) > 1:
            yield 'align = "lobe"\n'
        named = {"sigma_deg": sigma, "gamma_deg": gamma, "beta_deg": beta, "shift_deg": shift, "wavelength_nm": wavelength}
        yield "\n" + "".join(f"{key} = {grid}\n" for key, grid in named.items())
        yield f"\ngains_v_per_a = {self._gains()}\nreadings = {random.choice([2, 4, 4, 8])}\n"
        yield f"dark_every_s = {random.choice([60, 120, 600, 1800])}\ndark_readings = {random.choice([4, 16, 16, 32])}\n"
        if random.share() < 0.25:
            yield "signature = true\n"
        yield from self._open_beam(sigma)
        if random.share() < 0.3:
            bright = SPECULAR_DEG if SPECULAR_DEG in beta else random.choice(beta)  # in the dark, noise would be a drift
            pose = f"sigma_deg = {random.choice(sigma)}\nbeta_deg = {bright}\nshift_deg = {random.choice(shift)}\n"
            yield f"\n[drift]\nevery_s = {random.choice([60, 120, 300])}\n{pose}wavelength_nm = {random.choice(wavelength)}\n"
            yield f"limit = {random.choice([0.01, 0.05])}\n"

    def _gains(self) -> str:
        """Two or more gains of the rig, or the word for all of them."""
        if self.random.share() < 0.2:
            return '"automatic"'
        most = len(self.gains_v_per_a)
        chosen = self.random.sample(self.gains_v_per_a, self.random.choice(range(min(2, most), most + 1)))
        return f"[{', '.join(f'{each:g}' for each in sorted(chosen))}]"

    def _beta(self, anisotropic: bool) -> list[int]:
        """The half planes: the plane of incidence, a fan about it, or steps around the whole circle."""
        random = self.random
        kind = random.choice(["plane", "fan", "fan", "circle"])
        if kind == "plane":
            return random.choice([[SPECULAR_DEG], [0, SPECULAR_DEG]])
        if kind == "circle":
            return [*range(0, 360 if anisotropic else SPECULAR_DEG + 1, random.choice(CIRCLE_STEPS_DEG))]
        step = random.choice(STEPS_DEG)
        aside = min(random.choice([1, 2, 3, 4]), (SPECULAR_DEG - 1) // step)
        either = anisotropic or random.share() < 0.5
        return [SPECULAR_DEG + k * step for k in range(-aside, aside + 1 if either else 1)]

    def _open_beam(self, sigma: list[int]) -> Iterator[str]:
        """No scan, one pose, or a scan at one incidence."""
        random = self.random
        scanned = [each for each in sigma if each >= LEAST_SCANNED_SIGMA_DEG]
        kind = random.choice(["none", "none", "pose", "scan"])
        if kind == "pose":
            yield "open_beam = true\n"
        elif kind == "scan" and scanned:
            yield f"\n[open_beam]\nsigma_deg = [{random.choice(scanned)}]\nposes = {random.choice([5, 7])}\n"
            yield f"step_deg = {random.choice([0.3, 0.4, 0.5])}\n"
            if self._light == "transmitted" and random.share() < 0.4:
                yield 'scale = "open beam"\n'
