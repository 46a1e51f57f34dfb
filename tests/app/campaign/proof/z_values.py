"""The deviations, in their u, of the values of some structures' rigs: of which a test has a copy.

`python -m tests.app.campaign.proof.z_values` renews the copy, after a change of the model that is meant.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from goniotwin import examples
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.proof.proof import Proof
from goniotwin.app.campaign.proof.structures import draw_structure
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.studies.budget import finished_blocks
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.theory import deviations_in_u, true_bsdf
from goniotwin.app.rig import read_rig
from goniotwin.arrays import Floats
from goniotwin.linear_algebra import one_thread_in_linear_algebra

FILE = Path(__file__).parent / "z_values.npz"
STRUCTURES = (3, 13, 20, 25)
"""Brushed metal beside two lobes; lobes in transmission, aligned; a sum, over azimuths; Ward lit from behind, with a scan."""
RIGS = 3


def z_values() -> dict[str, Floats]:
    """Deviations (n,) in u of the good values, by seed and sample."""
    base = read_rig(examples.FOLDER / "proof" / "rig.toml")
    found: dict[str, Floats] = {}
    for number in STRUCTURES:
        structure = draw_structure(number, base)
        proof = Proof(structure.schedule, structure.rig, RIGS, Path(), wires=False)
        for seed in proof.seeds:
            with one_thread_in_linear_algebra():
                of_rig = _of_rig(replace(proof.plan, rig=proof.drawn.rig(seed)))
            found |= {f"{seed} {name}": z for name, z in of_rig.items()}
    return found


def _of_rig(plan: NewPlan) -> dict[str, Floats]:
    model = plan.rig.model()
    assert model is not None
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.journal"
        run_without_wires(plan, path)
        with Journal.open(path) as journal:
            reduction = evaluate_journal(journal).reduction
            for name in reduction.schedule.samples:
                points = BsdfPoints.join(list(finished_blocks(reduction, name)))
                good = points.where(points.good)
                found[name] = deviations_in_u(good, true_bsdf(model.samples[name], good))
    return found


if __name__ == "__main__":
    np.savez_compressed(FILE, **z_values())  # type: ignore[arg-type]  # the stub has a keyword of its own
