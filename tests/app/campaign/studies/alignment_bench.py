"""Random misaligned rigs and what an alignment finds of them, against the twin's own geometry.

The truth is the twin's own: the angles that a rig's seed draws, and the twin's exact optics. The estimator has the
sensitivities of the budget, and the journal.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.alignment import Alignment, known_displacement
from goniotwin.app.campaign.measurement_model.light_place import lit_spot
from goniotwin.app.campaign.measurement_model.pose import Views, mounting_inputs, rig_inputs
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.proof.virtual_rigs import DrawnRigs, run_with_wires
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule
from goniotwin.app.campaign.studies.alignment import AlignmentResult
from goniotwin.app.campaign.studies.budget import finished_blocks
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.sample_alignment import align_sample
from goniotwin.app.campaign.studies.theory import true_bsdf
from goniotwin.app.rig import RigDescription, nominal_instrument, parse_rig
from goniotwin.app.simulation.paper.gaussian_cut import relative_rms_percent
from goniotwin.arrays import Floats
from goniotwin.twin.optics import arc_direction
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.plant import Drawn, TwinModel
from goniotwin.twin.plant.disturbances import add_deviations
from tests.conftest import REPOSITORY

PROOF = REPOSITORY / "examples" / "proof"
SCHEDULE = PROOF / "alignment.toml"
SAMPLE = "two-sided-5"
OF_RIG = {
    "sample_tilt_deg": 0.1,
    "etalon_tilt_deg": 0.1,
    "mirror_tilt_deg": 0.1,
    "arc_tilt_deg": 0.1,
    "beam_tilt_deg": 0.1,
    "sigma_zero_deg": 0.2,
    "beta_zero_deg": 0.2,
    "shift_zero_deg": 0.2,
}
"""Half widths of the angles that are found: a tilt of the beam is one of the whole unit about the sample's centre."""
OF_READINGS = {"photodiode_angle_deg": 0.02, "photodiode_across_deg": 0.02, "position_deg": 0.005}
NONE = dict.fromkeys(
    (
        "sensor_tilt_deg",
        "sample_height_mm",
        "etalon_height_mm",
        "mirror_shift_mm",
        "illumination_shift_mm",
        "arc_shift_mm",
        "sensor_shift_mm",
    ),
    0.0,
)
CUT = """
name = "cut"
symmetry = "anisotropic"
samples = ["two-sided-5"]
etalon = "white-tile"
sigma_deg = [30]
beta_deg = [176, 180, 184]
shift_deg = [0, 1, 2, 3, 4]
wavelength_nm = [560]
gains_v_per_a = [1e6, 1e8, 1e10]
readings = 16
dark_every_s = 600
dark_readings = 64
"""
WIDTH_DEG = 5.0
"""Of the lobe."""
LEAST_EIGENVALUE = 1e-9
"""Of the covariance of predictions, in deg^2: smaller ones are of combinations that the predictions do not have."""


@dataclass(frozen=True)
class RigFindings:
    """What an alignment has found of one rig. Angles in deg.

    `errors` are those of the combinations, `u` their uncertainties. `direction` is the median error of the specular direction
    against the photodiode of the arc that is next to it, at poses that were not measured; `from_nominal` is that against the
    arc as if its photodiodes had no angles of their own. `predictions` is chi-square per degree of freedom of the latter,
    `residuals` that of the values. `dark` is the largest share of the hole that is dark at the measured incidences, with its
    sides along and across the plane of incidence, and `found_dark` that by the alignment. `cut_percent` is the
    relative RMS of the corrected cut in the plane of incidence against that of the same rig without tilts and zeros;
    `cuts_percent` are those of the cut as measured, corrected and aligned, against the theory.
    """

    seed: int
    rows: int
    errors: tuple[float, ...]
    u: tuple[float, ...]
    direction: float
    from_nominal: float
    predictions: float
    residuals: float
    dark: float
    found_dark: float
    findings: tuple[str, ...]
    cut_percent: float = math.nan
    cuts_percent: tuple[float, float, float] = (math.nan, math.nan, math.nan)


def alignment_rig(*, aligned: bool = False, further: str = "", stated: dict[str, float] | None = None) -> RigDescription:
    """The rig of the proof with large misalignments stated, and the twin drawn from them, or `aligned`."""
    text = (PROOF / "rig.toml").read_text(encoding="utf-8")
    table = {**OF_RIG, **OF_READINGS, **NONE} if stated is None else stated
    entries = "".join(f"{key} = {value}\n" for key, value in table.items())
    text += f"\n[uncertainty]\n{entries}{further}"
    if aligned:
        text += "\n[twin.disturbances]\n" + "".join(f"{key} = 0.0\n" for key in OF_RIG)
    return parse_rig(text, PROOF, "rig of the alignment")


def drawn_plan(schedule: ScheduleDescription, rig: RigDescription, seed: int) -> NewPlan:
    """The plan of a schedule on the virtual rig of a seed."""
    settings = reduction_settings(rig.file, schedule.file, None, schedule.name)
    drawn = DrawnRigs(rig, schedule.file.etalon, level=settings.certificate.level, years=settings.etalon_years).rig(seed)
    return make_plan(schedule, drawn)


def run(plan: NewPlan, path: Path, *, wires: bool = False) -> Path:
    """The journal of a plan."""
    (run_with_wires if wires else run_without_wires)(plan, path)
    return path


def model_of(plan: NewPlan) -> tuple[TwinModel, Drawn]:
    """The virtual rig of a plan, with what is drawn."""
    model = plan.rig.model()
    assert model is not None
    return model, Drawn(model.disturbances, model.seed, model.photodiodes.count)


def true_displacement(model: TwinModel, drawn: Drawn, views: Views, mounting: str) -> Floats:
    """Displacement (n, 2) in deg of the lobe, along the arc and across it, by the twin's exact geometry."""
    instrument = drawn.instrument(model.instrument)
    own = add_deviations(instrument.deviation("sample"), drawn.mounted(*_numbered(mounting)))
    instrument = replace(instrument, deviations={**instrument.deviations, "sample": own})
    found = []
    for k in range(views.polar.size):
        sigma = float(views.sigma_deg[k]) + drawn["sigma_zero"]
        scene = scene_at(instrument, sigma, float(views.gamma_deg[k]))
        polar = math.degrees(views.polar[k]) + drawn["shift_zero"] + np.array([0.0, 0.01])
        azimuth = np.full(2, math.degrees(views.azimuth[k]) + drawn["beta_zero"])
        d, ahead = scene.detectors(instrument, arc_direction(polar, azimuth, bool(views.lower[k])))[1]
        _, middle = lit_spot(instrument, sigma, float(views.gamma_deg[k]))
        light = scene.pupil[0] - scene.to_sample @ middle
        light /= np.linalg.norm(light)
        along = ahead - (ahead @ d) * d
        along /= np.linalg.norm(along)
        # The sample's own frame has the lit side up: for light from behind it is turned, and across stays d x along.
        across = np.cross(d, along)
        specular = light * [-1.0, -1.0, 1.0]
        nominal = _nominal(views, k)
        way = _logarithm(d, specular, along, across) - nominal
        found.append(-way)
    return np.degrees(np.array(found))


def dark_share(model: TwinModel, drawn: Drawn) -> float:
    """The largest share of the hole that the slit's image of a virtual rig leaves dark."""
    instrument = drawn.instrument(model.instrument)
    sigmas = (5.0, 17.0, 30.0, 42.0, 60.0, 75.0)
    return 1.0 - min(lit_spot(instrument, sigma + drawn["sigma_zero"], 0.0)[0] for sigma in sigmas)


def photodiode_error(model: TwinModel, drawn: Drawn, views: Views, found: Alignment) -> Floats:
    """The error (n, 2) of the own angles found of the photodiodes next to each view, along the arc and across it, deg."""
    upper, lower = (np.array(each) for each in (model.photodiodes.upper_deg, model.photodiodes.lower_deg))
    polar, known = np.degrees(views.polar), found.values
    errors = []
    for k, at in enumerate(polar.tolist()):
        c = int(np.argmin(np.abs(lower - at))) + upper.size if views.lower[k] else int(np.argmin(np.abs(upper - at)))
        own = [known[f"photodiode_{name}[{c}]"] - drawn[f"photodiode_{name}[{c}]"] for name in ("angle", "across")]
        errors.append([own[0], -own[1] if views.lower[k] else own[1]])
    return np.array(errors)


def _numbered(mounting: str) -> tuple[str, int]:
    sample, _, number = mounting.partition("#")
    return sample, int(number)


def _nominal(views: Views, k: int) -> Floats:
    """The way (2,) from a nominal direction to the nominal specular direction, rad."""
    up = -1.0 if views.lower[k] else 1.0
    p, a, s = views.polar[k], views.azimuth[k], math.radians(views.sigma_deg[k])
    d = np.array([math.sin(p) * math.cos(a), math.sin(p) * math.sin(a), up * math.cos(p)])
    along = np.array([math.cos(p) * math.cos(a), math.cos(p) * math.sin(a), -up * math.sin(p)])
    specular = np.array([-math.sin(s), 0.0, math.cos(s)])
    return _logarithm(d, specular, along, np.cross(d, along))


def _logarithm(d: Floats, other: Floats, along: Floats, across: Floats) -> Floats:
    """The way (2,) from a direction to another on the sphere, rad."""
    way = other - (other @ d) * d
    size = float(np.linalg.norm(way))
    angle = math.atan2(size, float(other @ d))
    return np.array([way @ along, way @ across]) * (angle / size if size > 0.0 else 1.0)


def unmeasured_views() -> Views:
    """Directions near the specular one at incidences and azimuths that the schedule does not have, on both sides."""
    places = [(sigma, gamma) for sigma in (11.0, 24.0, 36.0, 51.0, 68.0) for gamma in (45.0, 135.0, 250.0)]
    sigma = np.array([s for s, _ in places] + [180.0 - s for s, _ in places])
    polar = np.array([s for s, _ in places] * 2)
    n = sigma.size
    return Views(
        sigma,
        np.array([g for _, g in places] * 2),
        np.radians(polar),
        np.full(n, math.pi),
        sigma > 90.0,
        np.zeros(n, dtype=bool),
        np.zeros(n, dtype=bool),
    )


def predictions(alignment: Alignment, rig: RigDescription, views: Views, mounting: str) -> tuple[Floats, Floats]:
    """The displacement (n, 2), deg, by an alignment, and the covariance (2 n, 2 n) of it."""
    table = rig.file.uncertainty
    tilts = mounting_inputs(table, "sample", mounting)
    known = alignment.values
    values = np.tile([known.get(each.name, 0.0) for each in tilts], (views.polar.size, 1))
    moved, effects = known_displacement(nominal_instrument(rig.file), views, known, values)
    names = [each.name for each in (*rig_inputs(table), *tilts)]
    used = [names.index(each.name) for each in alignment.inputs]
    columns = np.concatenate(
        [np.concatenate([getattr(effects.common, axis), getattr(effects.sample, axis)], axis=1) for axis in ("along", "across")]
    )[:, used]
    return np.concatenate([moved.along, moved.across], axis=1), columns @ alignment.covariance @ columns.T


def judge_alignment(result: AlignmentResult, plan: NewPlan) -> RigFindings:
    """What an alignment has found against the truth."""
    model, drawn = model_of(plan)
    assert plan.rig.seed is not None
    errors = tuple(
        each.value - math.fsum(c * drawn[name] for name, c in each.coefficients.items()) for each in result.combinations
    )
    views, (mounting,) = unmeasured_views(), result.mountings
    truth = true_displacement(model, drawn, views, mounting)
    found, covariance = predictions(result.alignment, plan.rig, views, mounting)
    difference = found - truth
    own = photodiode_error(model, drawn, views, result.with_photodiodes)
    variance, vectors = np.linalg.eigh(covariance)
    known = variance > LEAST_EIGENVALUE
    scores = (vectors.T @ difference.T.ravel())[known] ** 2 / variance[known]
    return RigFindings(
        plan.rig.seed,
        len(plan.rows),
        errors,
        tuple(each.u for each in result.combinations),
        float(np.median(np.linalg.norm(difference + own, axis=1))),
        float(np.median(np.linalg.norm(difference, axis=1))),
        float(np.mean(scores)),
        result.chi_square,
        dark_share(model, drawn),
        0.0 if result.light is None else result.light.dark,
        result.findings,
    )


def find(seed: int, folder: Path, *, wires: bool = False, cut: bool = True) -> RigFindings:
    """The alignment of one random rig, from the example schedule; with `cut` the cut in the plane of incidence too."""
    schedule = parse_schedule(SCHEDULE.read_text(encoding="utf-8"), "alignment")
    plan = drawn_plan(schedule, alignment_rig(), seed)
    with Journal.open(run(plan, folder / f"{seed}.journal", wires=wires)) as journal:
        evaluation = evaluate_journal(journal)
        result = align_sample(evaluation.reduction, evaluation.closure, SAMPLE)
    found = judge_alignment(result, plan)
    if not cut:
        return found
    cuts = {}
    for aligned in (False, True):
        own = drawn_plan(parse_schedule(CUT, "cut"), alignment_rig(aligned=aligned), seed)
        path = run(own, folder / f"{seed} {aligned}.journal")
        cuts["aligned" if aligned else "measured"] = cut_points(path, None)
        if not aligned:
            cuts["corrected"] = cut_points(path, result.alignment)
    theory = true_bsdf(model_of(plan)[0].samples[SAMPLE], cuts["aligned"])
    rms = [relative_rms_percent(cuts[name].bsdf, theory) for name in ("measured", "corrected", "aligned")]
    between = relative_rms_percent(cuts["corrected"].bsdf, cuts["aligned"].bsdf)
    return replace(found, cut_percent=between, cuts_percent=(rms[0], rms[1], rms[2]))


def cut_points(path: Path, alignment: Alignment | None) -> BsdfPoints:
    """The points of the cut in the plane of incidence, to two widths of the lobe, corrected by an alignment."""
    with Journal.open(path) as journal:
        reduction = evaluate_journal(journal).reduction
        reduction = replace(reduction, settings=replace(reduction.settings, alignment=alignment))
        points = BsdfPoints.join(list(finished_blocks(reduction, SAMPLE)))
    return points.where(points.in_plane & points.good & (points.theta_deg <= 2.0 * WIDTH_DEG + 1e-6))
