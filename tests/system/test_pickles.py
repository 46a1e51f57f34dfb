"""Rig files and datasets that are sent to another process, or copied."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import goniotwin
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import read_rig
from tests.conftest import REPOSITORY, SMALL

RIGS = sorted((REPOSITORY / "examples" / "rigs").glob("*.toml"))
OTHER = """
import pickle, sys
import numpy as np

rig, dataset = pickle.load(sys.stdin.buffer)
print(rig.model_hash())
print(np.sum(dataset.covariance()).hex())
"""
"""What another process finds in a pickle."""


@pytest.mark.parametrize(
    "path",
    [pytest.param(each, marks=[pytest.mark.long] if k else []) for k, each in enumerate(RIGS)],
    ids=lambda path: path.stem,
)
def test_the_rig_file_and_the_dataset_of_a_shipped_rig_are_pickled_and_copied(path: Path, tmp_path: Path) -> None:
    rig = read_rig(path)
    run_without_wires(make_plan(parse_schedule(SMALL, "small.toml"), rig), tmp_path / "a.journal")
    dataset = goniotwin.open(tmp_path / "a.journal")
    sent = pickle.dumps((rig, dataset))
    for same_rig, same in (pickle.loads(sent), copy.deepcopy((rig, dataset))):
        assert (same_rig, same_rig.file, type(same_rig.file)) == (rig, rig.file, type(rig.file))
        assert same_rig.model_hash() == rig.model_hash()
        assert repr(same) == repr(dataset)
        for column in ("bsdf", "u", "theta_deg", "phi_deg"):
            np.testing.assert_array_equal(getattr(same, column), getattr(dataset, column))
        np.testing.assert_array_equal(same.covariance(), dataset.covariance())
        assert same.notes == dataset.notes
    found = subprocess.run([sys.executable, "-c", OTHER], input=sent, capture_output=True, timeout=300, check=True)
    assert found.stdout.decode().split() == [rig.model_hash(), float(np.sum(dataset.covariance())).hex()]
