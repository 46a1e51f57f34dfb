"""What the golden files hold, computed: a function for each folder of tables, whose columns have names of their own."""

import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from tests.conftest import ONE_WAY, REPOSITORY, changed
from tests.golden import files, product
from tests.golden.compare import BOUNDS, PLAN, POINTS, ROWS, TABLE_3
from tests.golden.files import Table, Tables, sampled

HERE = Path(__file__).resolve().parent
SCHEDULES = REPOSITORY / "examples" / "schedules"
RIGS = REPOSITORY / "examples" / "rigs"
VIRTUAL, FILTERS = RIGS / "virtual.toml", RIGS / "filters.toml"

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
PLAN_ROWS, PLAN_BLOCKS = 60, 40
"""So many rows of a long plan are kept one by one, and sums over so many stretches of the others."""
ALL_ROWS = 2500
"""Of tables of points with more rows than these only some are kept one by one, and sums over blocks of the others."""
EVERY, BLOCK = 16, 48

EXPORTS = ("csv", "ddr")
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


def rig_file(folder: Path, original: Path, *changes: tuple[str, str]) -> Path:
    """A rig file of the examples with changes, in a folder."""
    path = folder / "rig.toml"
    path.write_text(changed(original.read_text(encoding="utf-8"), changes), encoding="utf-8")
    return path


def run(schedule: Path, rig: Path, journal: Path) -> Path:
    """Runs a whole campaign; returns its journal."""
    assert product.answer("run", schedule, "--rig", rig, "--out", journal)["state"] == "done"
    return journal


def _table(columns: Mapping[str, Iterable[object]]) -> Table:
    """The table of columns that are compared by BOUNDS."""
    return files.table(columns, BOUNDS)


# ---- rows ----


def rows_record(rows: list[product.Row]) -> Tables:
    """The rows of a journal, their readings by gain, and the counts of each photodiode in each reading."""
    places = sorted({name for row in rows for name in row["positions"] or ()})
    exposures = [(row["identity"], each) for row in rows for each in row["readings"]]
    counted = [(name, each["gain_v_per_a"], k, line) for name, each in exposures for k, line in enumerate(each["counts"])]
    channels = range(max((len(line) for *_, line in counted), default=0))
    return {
        "rows": _table(
            {
                **{name: [row[name] for row in rows] for name in ("identity", "kind", "sample", "planned", "flags")},
                **{name: [row[name] for row in rows] for name in ("started_s", "ended_s")},
                **{f"position {name}": [(row["positions"] or {}).get(name) for row in rows] for name in places},
            }
        ),
        "readings": _table(
            {
                "identity": [name for name, _ in exposures],
                **{key: [each[key] for _, each in exposures] for key in ("gain_v_per_a", "first_s", "period_s", "monitor_a")},
            }
        ),
        "counts": _table(
            {
                **{title: [each[k] for each in counted] for k, title in enumerate(("identity", "gain_v_per_a", "reading"))},
                **{str(k): [line[k] for *_, line in counted] for k in channels},
            }
        ),
    }


def planned(record: Tables) -> Tables:
    """What is exactly the same in each run of the planned rows of a record: everything but times and the monitor's currents."""
    rows = record["rows"].columns
    identities = {name for name, each in zip(rows["identity"], rows["planned"], strict=True) if each == "yes"}
    result = {}
    for name, each in record.items():
        chosen = each.take(k for k, identity in enumerate(each.columns["identity"]) if identity in identities)
        result[name] = Table({title: column for title, column in chosen.columns.items() if title not in ROWS})
    return result


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


def points_record(journal: Path) -> Tables:
    """The points of a journal, a table a sample; the flags of a point are the names of the marks that it has."""
    record: Tables = {}
    for sample, (columns, marks) in product.points(journal).items():
        flags = [[name for name in sorted(marks) if marks[name][k]] for k in range(len(columns["bsdf"]))]
        record |= _in_short(f"points-{sample}", _table({**columns, "flags": flags}))
    return record


def _in_short(name: str, points: Table) -> Tables:
    if len(points) <= ALL_ROWS:
        return {name: points}
    some, rest = sampled(points, EVERY, BLOCK, tuple(POINTS))
    return {name: some, f"{name}-rest": rest}


# ---- plans ----


def plan_record(schedule: Path, rig: Path) -> Tables:
    """The rows of a plan, in short, with their durations."""
    columns = _table(product.plan_rows(schedule, rig))
    some, rest = sampled(columns, -(-len(columns) // PLAN_ROWS), -(-len(columns) // PLAN_BLOCKS), tuple(PLAN))
    return {rig.stem: some, f"{rig.stem}-rest": rest}


def plans_record(schedule: str) -> Tables:
    """The plans of a schedule of the examples, by rig."""
    record: Tables = {}
    for rig in PLANS[schedule]:
        record |= plan_record(SCHEDULES / f"{schedule}.toml", RIGS / f"{rig}.toml")
    return record


def table_3_record() -> Tables:
    """The noise-free cells of the paper's Table 3, percent."""
    return {"noise-free": files.table(product.table3_noise_free(), TABLE_3)}


# ---- tables ----


def table_lines(path: Path) -> list[str]:
    """The lines of a .ddr, .ddt or .csv file that are no comments."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if not line.startswith(("#", ";;"))]


def simulation_record(name: str, folder: Path) -> list[str]:
    """What `goniotwin simulate sample` writes to one file."""
    product.answer("simulate", "sample", *SIMULATIONS[name], "--out", folder / name)
    return table_lines(folder / name)


def exported_lines(journal: Path, form: str, folder: Path) -> list[str]:
    """What `goniotwin export` makes of a journal in a format."""
    out = folder / f"exported.{form}"
    product.answer("export", journal, "--format", form, "--out", out)
    return table_lines(out)


# ---- journals ----


def copied(folder: Path) -> tuple[Path, Path]:
    """Copies of the two journals, the finished one and the interrupted one: to read a journal may leave files beside it."""
    for name in ("finished", "interrupted"):
        shutil.copyfile(files.DATA / f"{name}.journal", folder / f"{name}.journal")
    return folder / "finished.journal", folder / "interrupted.journal"


def resumed_record(journal: Path) -> Tables:
    """The rows and points of an interrupted journal once it has been resumed on its rig, which states the side of its opal."""
    rig = journal.with_name("rig.toml")
    rig.write_text(changed(product.campaign_entry(journal, "rig"), (ONE_WAY,)), encoding="utf-8")
    answer = product.answer("run", "--resume", journal, "--rig", rig)
    assert answer["state"] == "done"
    return rows_record(product.measured_rows(journal)) | points_record(journal)


def listed(folder: Path) -> list[dict[str, Any]]:
    """The campaigns of a folder as `goniotwin runs` lists them, without the folder."""
    found = product.answer("runs", folder)
    assert found["unreadable"] == []
    return [{**each, "journal": Path(each["journal"]).name} for each in found["campaigns"]]


def make_journals(target: Path) -> Tables:
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
