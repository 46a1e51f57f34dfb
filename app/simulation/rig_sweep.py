"""Samples on random rigs, as a sweep: what the instrument measures of them when its elements are off by chance.

Each rig has tilts and shifts of mirrors, beam, sample and arc, drawn evenly within limits and keyed by its number; rig 0 has
none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.app.formats import PointStream
from goniotwin.app.formats.registry import Holds
from goniotwin.app.simulation.estimate import SIGNIFICANT
from goniotwin.app.simulation.files import write_content
from goniotwin.app.simulation.forward_sweep import INSTRUMENT, SAMPLE
from goniotwin.app.simulation.paper.worst_corner import shifts, tilts
from goniotwin.app.sweeps.chunk_files import ChunkFiles
from goniotwin.app.sweeps.content import as_data, from_data
from goniotwin.app.sweeps.runners import Runner
from goniotwin.app.sweeps.specification import Arrays, Specification
from goniotwin.app.sweeps.sweep import Report, run_sweep
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument, Pose, Scatterer, arc_direction, luminance_factors

VERSION = 1
SIZE = 16
"""Items, a sample on a rig each, of a chunk: about a second."""
MOST_RIGS = 100_000


@dataclass(frozen=True, eq=False)
class RigSweep:
    """Samples on rigs, measured at incidences `sigma_deg` (s,) by detectors at `polar_deg` (n,) and `azimuth_deg` (n,).

    The tilts are within `tilt_deg`, the shifts within `shift_mm`, on top of the instrument's own deviations. Raises UserError.
    """

    samples: tuple[Scatterer, ...]
    instrument: Instrument
    sigma_deg: Floats
    polar_deg: Floats
    azimuth_deg: Floats
    tilt_deg: float
    shift_mm: float
    seed: int

    def __post_init__(self) -> None:
        for name, value, last in (("--tilt", self.tilt_deg, 1.0), ("--shift", self.shift_mm, 10.0)):
            if not 0.0 <= value <= last:
                raise UserError(f"{name}: {value:g} is out of range; give 0 to {last:g}")
        if not 0 <= self.seed < 2**63:
            raise UserError(f"--seed: {self.seed} is not possible; give a whole number from 0")
        for each in self.samples:
            if each.spectrum is not None:
                raise UserError(
                    f"--sample {each.name!r}: has a spectrum, and rigs are simulated without one; give a grey sample"
                )

    @cached_property
    def specification(self) -> Specification:
        """The sweep; an item is a sample on a rig, and all samples of a rig follow each other. Names are not in it."""
        names = ("instrument", "sigma_deg", "polar_deg", "azimuth_deg", "tilt_deg", "shift_mm")
        content = {name: as_data(getattr(self, name)) for name in names}
        content["samples"] = [as_data(replace(each, name="")) for each in self.samples]
        return Specification.of("rigs", VERSION, SIZE, self.seed, content)

    def chunks(self, rigs: int) -> int:
        """The number of chunks of so many random rigs, and of the one without deviations."""
        return self.specification.chunks((rigs + 1) * len(self.samples))

    @cached_property
    def tolerances(self) -> list[tuple[str, str, float]]:
        """Element, name and limit of each deviation."""
        known = [*tilts(self.instrument, self.tilt_deg), *shifts(self.shift_mm)]
        return [(each.element, each.name, each.amount) for each in known]

    def deviations(self, rig: int) -> Floats:
        """The deviations (d,) of a rig, in degrees and mm as in `tolerances`."""
        limits = np.array([limit for _, _, limit in self.tolerances])
        if rig == 0:
            return np.zeros(limits.size)
        generator = np.random.Generator(np.random.Philox(key=np.array([self.seed, rig], np.uint64)))
        drawn: Floats = limits * generator.uniform(-1.0, 1.0, limits.size)
        return drawn

    def instrument_of(self, rig: int) -> Instrument:
        """The instrument of a rig."""
        found = dict(self.instrument.deviations)
        for (element, name, _), amount in zip(self.tolerances, self.deviations(rig).tolist(), strict=True):
            before = found.get(element, Deviation())
            found[element] = replace(before, **{name: getattr(before, name) + amount})
        return replace(self.instrument, deviations=found)

    def factors(self, item: int) -> Floats:
        """The luminance factors (s, n) of an item; NaN where the etalon gives no light. Raises UserError."""
        rig, sample = divmod(item, len(self.samples))
        directions = arc_direction(self.polar_deg, self.azimuth_deg, False)
        poses = [Pose(sigma, directions) for sigma in self.sigma_deg.tolist()]
        try:
            return np.array(luminance_factors(self.instrument_of(rig), poses, self.samples[sample]))
        except ValueError as error:
            raise UserError(f"sample {sample + 1}, rig {rig}: {error}") from None


@dataclass(frozen=True)
class RmsSpread:
    """The relative RMS of a sample at one sigma over the rigs, in percent."""

    sample: str
    sigma: float
    median_percent: float
    percentile_95_percent: float
    worst_percent: float
    worst_rig: int

    @classmethod
    def of(cls, sample: str, sigma: float, rms: Floats) -> "RmsSpread":
        """That of the values of all rigs (rigs,)."""
        median, high, worst = float(np.median(rms)), float(np.percentile(rms, 95.0)), float(rms.max())
        return cls(sample, sigma, 100.0 * median, 100.0 * high, 100.0 * worst, 1 + int(np.argmax(rms)))


@dataclass(frozen=True, eq=False)
class RigResults:
    """What deviations do to samples: luminance factors (rigs + 1, samples, s, n), those of the rig without deviations first."""

    sweep: RigSweep
    factors: Floats

    @cached_property
    def relative_rms(self) -> Floats:
        """Root mean square (rigs, samples, s) of the relative deviations from the rig without deviations.

        Over the detectors that have at least a hundredth of the largest value there, and a value on both rigs.
        """
        aligned, others = np.nan_to_num(self.factors[0]), self.factors[1:]
        bright = (aligned > 0.0) & (aligned >= SIGNIFICANT * aligned.max(axis=-1, keepdims=True))
        counted = bright & np.isfinite(others)
        squares = np.where(counted, others / np.where(bright, aligned, 1.0) - 1.0, 0.0) ** 2
        result: Floats = np.sqrt(squares.sum(axis=-1) / counted.sum(axis=-1))
        return result

    @property
    def spreads(self) -> list[RmsSpread]:
        """By sample and sigma the median, the 95th percentile and the worst rig."""
        return [
            RmsSpread.of(sample.name, sigma, self.relative_rms[:, k, m])
            for k, sample in enumerate(self.sweep.samples)
            for m, sigma in enumerate(self.sweep.sigma_deg.tolist())
        ]

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        return {
            "simulated": True,
            "rigs": self.factors.shape[0] - 1,
            "tilt_deg": self.sweep.tilt_deg,
            "shift_mm": self.sweep.shift_mm,
            "seed": self.sweep.seed,
            "deviations": [f"{element}.{name}" for element, name, _ in self.sweep.tolerances],
            "samples": self.spreads,
        }

    def columns(self) -> dict[str, Any]:
        """The columns of the file: a row for each sample, sigma and rig, with the rig's deviations."""
        rigs, samples, sigmas = self.relative_rms.shape
        shape = np.indices((samples, sigmas, rigs)).reshape(3, -1)
        drawn = np.array([self.sweep.deviations(rig) for rig in range(1, rigs + 1)])
        return {
            "sample": np.array([each.name for each in self.sweep.samples])[shape[0]],
            "sigma_deg": self.sweep.sigma_deg[shape[1]],
            "rig": shape[2] + 1,
            "relative_rms": self.relative_rms.transpose(1, 2, 0).ravel(),
            **{f"{element}_{name}": drawn[shape[2], k] for k, (element, name, _) in enumerate(self.sweep.tolerances)},
        }


def simulate_rigs(
    sweep: RigSweep, rigs: int, files: ChunkFiles, runner: Runner, report: Report = lambda _done, _now: None
) -> RigResults:
    """Simulate the samples on so many random rigs. Raises UserError."""
    if not 1 <= rigs <= MOST_RIGS:
        raise UserError(f"--rigs: {rigs} is not possible; give 1 to {MOST_RIGS}")
    count = sweep.chunks(rigs)
    for reason in run_sweep(factors_of_chunk, files, count, runner, report).values():
        raise UserError(reason)
    found = []
    for chunk in range(count):
        if (computed := files.read(chunk)) is None:
            raise UserError(f"{files.path(chunk)}: is missing or damaged; run the same command again")
        found.append(computed.arrays["factors"])
    factors = np.concatenate(found)[: (rigs + 1) * len(sweep.samples)]
    dark = ~(factors > 0.0).any(axis=-1)
    if dark.any():
        item, sigma = np.argwhere(dark)[0].tolist()
        where = f"sigma {sweep.sigma_deg[sigma]:g}: no detector has a value on rig {item // len(sweep.samples)}"
        raise UserError(f"{where}: the mirror unit blocks all of them, or the beam; give other --polar, or a smaller --tilt")
    return RigResults(sweep, factors.reshape(rigs + 1, len(sweep.samples), *factors.shape[1:]))


def write_rigs(results: RigResults, path: Path, heading: Sequence[str]) -> None:
    """Write the table of all rigs. Raises UserError."""
    write_content(path, Holds.COLUMNS, PointStream(list(heading), [results.columns()]))


def factors_of_chunk(specification: Specification, chunk: int) -> Arrays:
    """The luminance `factors` (items, s, n) of a chunk."""
    sweep = _sweep_of(specification)
    return {"factors": np.array([sweep.factors(item) for item in specification.items(chunk)])}


@lru_cache(maxsize=1)
def _sweep_of(specification: Specification) -> RigSweep:
    """The sweep whose items this process computes."""
    content = {name: from_data(each, (*INSTRUMENT, *SAMPLE)) for name, each in specification.data.items()}
    return RigSweep(**content, seed=specification.seed)
