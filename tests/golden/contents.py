"""What the golden files hold, computed: one function for each file. Plain values for JSON, under names of their own."""

import base64
import hashlib
import itertools
import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Flags, Floats
from tests.conftest import ONE_WAY, REPOSITORY, changed
from tests.golden import files, product

HERE = Path(__file__).resolve().parent
SCHEDULES = REPOSITORY / "examples" / "schedules"
RIGS = REPOSITORY / "examples" / "rigs"
VIRTUAL, FILTERS = RIGS / "virtual.toml", RIGS / "filters.toml"

Json = dict[str, Any]

STEADY = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))
STRAY = (("[twin.light]", "[twin.optics]\nstray = true\n\n[twin.frames]\nreflectance = 0.045\n\n[twin.light]"),)
TRACED = (
    (
        "[twin.light]",
        '[twin.optics]\nstray = true\nfield_deg = 2.5\nestimator = "forward"\nforward_error = 0.2\n\n'
        "[twin.frames]\nreflectance = 0.3\n\n[twin.light]",
    ),
    ('form = "one_over_e"\nquantity = "luminance"\n', ""),
    ("width_deg = 5.0", "width_deg = 30.0"),
)
PLANS = {
    "anisotropic": ("virtual",),
    "closure": ("virtual",),
    "dense-lobe-spectral": ("virtual", "filters"),
    "diffuse-spectral": ("virtual", "filters"),
    "first": ("first",),
    "paper-order": ("virtual",),
    "quick": ("virtual",),
    "transmission": ("virtual", "filters"),
}
"""Each schedule of the examples with the rigs of the examples that it is for."""
PLAN_ROW = (
    "identity",
    "kind",
    "sample",
    "pose (gamma, sigma, beta, shift)",
    "wavelength_nm",
    "gains",
    "readings",
    "automatic gains",
    "target",
    "longest_s",
)
SPANS = 40
"""So many stretches of a plan have a duration of their own in the golden file."""
ALL_POINTS = 2500
"""Of more points than these only some are kept one by one, and sums over blocks of all."""
EVERY, BLOCK = 16, 48

GRID = ("--theta", "0:60:2.5", "--phi", "0:180:15")
DETECTORS = ("--polar", "0:80:5", "--azimuth", "0:180:20")
SIMULATIONS: dict[str, tuple[str, ...]] = {
    "gaussian.ddr": ("--sample", "gaussian:width_deg=5", "--sigma", "30", *GRID),
    "sum.csv": (
        "--sample",
        "lambertian:reflectance=0.5+regular:reflectance=0.04+gaussian:width_deg=15,reflectance=0.3",
        "--sigma",
        "20,50",
        "--rays",
        "64",
        "--rig",
        str(VIRTUAL),
        *DETECTORS,
    ),
    "through.ddt": (
        "--sample",
        "gaussian:width_deg=20,transmits=true,refraction=1.5,reflectance=0.4,side=back",
        "--side",
        "back",
        "--sigma",
        "30",
        *DETECTORS,
        *GRID,
    ),
    "through.csv": (
        "--sample",
        "gaussian:width_deg=20,transmits=true,reflectance=0.4",
        "--transmitted",
        "--sigma",
        "30",
        "--no-obstruction",
        *DETECTORS,
    ),
    "forward.csv": (
        "--sample",
        "gaussian:width_deg=15",
        "--sigma",
        "30",
        "--estimator",
        "forward",
        "--paths",
        "100000",
        "--seed",
        "4",
        "--stray",
        *DETECTORS,
    ),
}
"""Each file with the options of `goniotwin simulate sample` that write it."""


def digest_of(value: object) -> str:
    """SHA-256 of a value's JSON."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def rig_file(folder: Path, original: Path, *changes: tuple[str, str]) -> Path:
    """A rig file of the examples with changes, in a folder."""
    path = folder / "rig.toml"
    path.write_text(changed(original.read_text(encoding="utf-8"), changes), encoding="utf-8")
    return path


def run(schedule: Path, rig: Path, journal: Path) -> Path:
    """Runs a whole campaign; returns its journal."""
    assert product.answer("run", schedule, "--rig", rig, "--out", journal)["state"] == "done"
    return journal


# ---- rows ----


def rows_record(rows: list[product.Row]) -> Json:
    """Rows with a digest of what has to be exactly the same: identities, flags, positions, gains and counts."""
    return {"digest": digest_of(list(map(exact_part, rows))), "rows": rows}


def exact_part(row: product.Row) -> Json:
    """What has to be the same to the last bit, wherever it is computed."""
    about = {key: row[key] for key in ("identity", "kind", "sample", "planned", "positions", "flags")}
    return {**about, "readings": [[each["gain_v_per_a"], each["counts"]] for each in row["readings"]]}


def quick_journal(folder: Path) -> Path:
    """quick.toml as run on the virtual rig, on its clock, with its seed."""
    return run(SCHEDULES / "quick.toml", VIRTUAL, folder / "quick.journal")


def traced_journal(folder: Path) -> Path:
    """A campaign whose light the forward estimator traces."""
    return run(HERE / "traced.toml", rig_file(folder, VIRTUAL, *TRACED), folder / "traced.journal")


def everything_journal(folder: Path) -> Path:
    """The campaign that has everything."""
    return run(HERE / "everything.toml", rig_file(folder, FILTERS, *STRAY), folder / "everything.journal")


def small_transmission_journal(folder: Path) -> Path:
    """A few poses of transmission.toml."""
    return run(HERE / "transmission-small.toml", VIRTUAL, folder / "transmission-small.journal")


def transmission_journal(folder: Path) -> Path:
    """transmission.toml, whole."""
    return run(SCHEDULES / "transmission.toml", VIRTUAL, folder / "transmission.journal")


JOURNALS: dict[str, Callable[[Path], Path]] = {
    "quick": quick_journal,
    "traced": traced_journal,
    "everything": everything_journal,
    "transmission-small": small_transmission_journal,
    "transmission": transmission_journal,
}
"""The campaigns whose points are golden. The last one takes long."""


# ---- points ----


def points_record(journal: Path) -> Json:
    """The points of a journal, by sample."""
    return {name: _points_of_one(columns, marks) for name, (columns, marks) in product.points(journal).items()}


def _points_of_one(columns: dict[str, npt.NDArray[Any]], marks: dict[str, Flags]) -> Json:
    count = len(columns["bsdf"])
    every = 1 if count <= ALL_POINTS else EVERY
    return {
        "count": count,
        "every": every,
        "columns": {name: numbers(column[::every]) for name, column in columns.items()},
        "sums": {} if every == 1 else {name: numbers(block_sums(column)) for name, column in columns.items()},
        "marks": {name: [int(mark.sum()), bits(mark)] for name, mark in marks.items()},
    }


def bits(mark: Flags) -> str:
    """Eight points a byte, in base 64."""
    return base64.b64encode(np.packbits(mark).tobytes()).decode()


def block_sums(column: npt.NDArray[Any]) -> Floats:
    """For each block of points the sum of the magnitudes, each with a weight of its own, and how many are finite or negative.

    No value can change without its block's sum: what is summed is positive.
    """
    values = np.asarray(column, dtype=np.float64)
    finite = np.isfinite(values)
    weights = 1.0 + (0.618033988749895 * np.arange(values.size)) % 1.0
    magnitudes = np.where(finite, np.abs(values), 0.0) * weights
    edges = np.arange(0, values.size, BLOCK)
    summed = [np.add.reduceat(each.astype(float), edges) for each in (magnitudes, finite, finite & (values < 0.0))]
    return np.concatenate(summed)


def numbers(values: npt.NDArray[Any]) -> list[float | int | None]:
    """As JSON has them; None where there is no number."""
    return [None if value != value else value for value in values.tolist()]


# ---- plans ----


def plan_record(schedule: Path, rig: Path) -> Json:
    """The rows of a plan, in short, and its durations."""
    rows, seconds = product.plan_rows(schedule, rig)
    edges = np.unique(np.linspace(0, len(rows), SPANS + 1).astype(int)).tolist()
    kinds = sorted({row[1] for row in rows})
    return {
        "count": len(rows),
        "digest": digest_of(rows),
        "first": [dict(zip(PLAN_ROW, row, strict=True)) for row in rows[:6]],
        "last": [dict(zip(PLAN_ROW, row, strict=True)) for row in rows[-6:]],
        "seconds": sum(seconds),
        "seconds_of_spans": [sum(seconds[i:j]) for i, j in itertools.pairwise(edges)],
        "seconds_of_kinds": {kind: sum(s for s, row in zip(seconds, rows, strict=True) if row[1] == kind) for kind in kinds},
    }


def plans_record(schedule: str) -> Json:
    """The plans of a schedule of the examples, by rig."""
    return {rig: plan_record(SCHEDULES / f"{schedule}.toml", RIGS / f"{rig}.toml") for rig in PLANS[schedule]}


# ---- tables ----


def table_lines(path: Path) -> list[str]:
    """The lines of a .ddr, .ddt or .csv file that are no comments."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if not line.startswith(("#", ";;"))]


def simulation_record(name: str, folder: Path) -> list[str]:
    """What `goniotwin simulate sample` writes to one file."""
    product.answer("simulate", "sample", *SIMULATIONS[name], "--out", folder / name)
    return table_lines(folder / name)


def exports_record(journal: Path, folder: Path) -> Json:
    """What `goniotwin export` makes of a journal."""
    lines = {}
    for form in ("csv", "ddr"):
        out = folder / f"exported.{form}"
        product.answer("export", journal, "--format", form, "--out", out)
        lines[form] = table_lines(out)
    return lines


# ---- journals ----


def copied(folder: Path) -> tuple[Path, Path]:
    """Copies of the two journals, the finished one and the interrupted one: to read a journal may leave files beside it."""
    for name in ("finished", "interrupted"):
        shutil.copyfile(files.DATA / f"{name}.journal", folder / f"{name}.journal")
    return folder / "finished.journal", folder / "interrupted.journal"


def finished_record(journal: Path, folder: Path) -> Json:
    """What a finished journal is reduced to and exported as."""
    return {"points": points_record(journal), "exports": exports_record(journal, folder)}


def resumed_record(journal: Path) -> Json:
    """The rows and points of an interrupted journal once it has been resumed on its rig, which states the side of its opal."""
    rig = journal.with_name("rig.toml")
    rig.write_text(changed(product.campaign_entry(journal, "rig"), (ONE_WAY,)), encoding="utf-8")
    answer = product.answer("run", "--resume", journal, "--rig", rig)
    assert answer["state"] == "done"
    return {**rows_record(product.measured_rows(journal)), "points": points_record(journal)}


def listed(folder: Path) -> list[Json]:
    """The campaigns of a folder as `goniotwin runs` lists them, without the folder."""
    found = product.answer("runs", folder)
    assert found["unreadable"] == []
    return [{**each, "journal": Path(each["journal"]).name} for each in found["campaigns"]]


def make_journals(target: Path) -> Json:
    """Makes the two journals, and the rows of the second as they are in a run that nothing disturbs.

    Only the folder of their rig file is put out of them: it is another on every computer.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(HERE / "few.toml", rig_file(folder, VIRTUAL), folder / "finished.journal")
        steady = rig_file(folder, VIRTUAL, *STEADY)
        whole = run(HERE / "few.toml", steady, folder / "whole.journal")
        product.run_and_kill(HERE / "few.toml", steady, folder / "interrupted.journal", 9)
        product.put_in_order(folder / "interrupted.journal")
        for each in ("finished.journal", "interrupted.journal"):
            product.change_campaign(folder / each, "rig_folder", ".")
            product.put_in_order(folder / each)
            shutil.copyfile(folder / each, target / each)
        return rows_record(product.measured_rows(whole))
