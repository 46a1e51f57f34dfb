"""What many rows of a journal take, by its structure: geometry by poses, readings some rows at a time."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.geometry.arcs import arc_views, views_at_sigma
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.journal.reading import columns_of_readings
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction import arc_geometry
from goniotwin.app.campaign.reduction.arc_geometry import ArcGeometry
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal, reduce_to_files
from goniotwin.app.rig import read_rig
from tests.app.campaign.reduction.long_journal import write_long_journal
from tests.conftest import RIG

BESIDE, BEHIND = (0.0, 30.0, 90.0, 0.5), (0.0, 150.0, 180.0, 0.0)
POSES = [(0.0, 30.0, 180.0, 0.0), BESIDE, (20.0, 30.0, 180.0, 0.0), BEHIND, BESIDE]
POSES_OF_JOURNAL = 2 * 5 * 3
"""Sigmas, betas and shifts."""


def test_views_of_many_poses_together_are_those_of_each_alone() -> None:
    rig = read_rig(RIG).file
    for pose, views in zip(POSES, ArcGeometry(rig).views_at(POSES), strict=True):
        for (view, blocked), alone in zip(views, arc_views(rig, pose), strict=True):
            sigmas = {pose[1], alone.etalon_pose(pose)[1]}
            hidden = [blocked_by_mirrors(rig, sigma, alone.zenith, alone.azimuth, pose[0]) for sigma in sigmas]
            assert np.array_equal(blocked, np.any(hidden, axis=0))
            for name, value in vars(alone).items():
                assert np.array_equal(getattr(view, name), value), name


@pytest.mark.parametrize("wavelengths", [1, 4])
def test_a_pose_is_computed_once_however_many_wavelengths_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wavelengths: int
) -> None:
    computed = []

    def count(*arguments: object) -> object:
        computed.extend(arguments[2].tolist())  # type: ignore[attr-defined]  # the betas of the poses
        return views_at_sigma(*arguments)  # type: ignore[arg-type]  # handed on as they are

    monkeypatch.setattr(arc_geometry, "views_at_sigma", count)
    write_long_journal(tmp_path / "a.journal", wavelengths, 3)
    with Journal.open(tmp_path / "a.journal") as journal, reduce_to_files(journal, tmp_path) as found:
        assert found.samples["gaussian-5"].size > 0
    assert len(computed) == 2 * POSES_OF_JOURNAL  # for each arc


def test_rows_are_recorded_in_the_order_asked_for_and_a_few_at_once(tmp_path: Path) -> None:
    write_long_journal(tmp_path / "a.journal", 2, 2)
    with Journal.open(tmp_path / "a.journal") as journal:
        numbers = journal.row_numbers("measure", "dark").tolist()[::-1]
        numbers.insert(3, 10_000_000)  # no such row
        blocks = list(journal.recorded(numbers, 7))
        assert max(each.numbers.size for each in blocks) == 7
        assert [number for each in blocks for number in each.numbers.tolist()] == numbers[:3] + numbers[4:]
        everything = journal.all_recorded(10**9, "measure", "dark")
        assert everything is not None
        one_by_one = list(journal.rows_of(numbers))
        for rows in (blocks, [everything.of(np.array(numbers))]):
            found = iter(one_by_one)
            for block in rows:
                for k, started_s in enumerate(block.started_s.tolist()):
                    row = next(found).data
                    here = [block.readings.reading(j) for j in np.flatnonzero(block.readings.row == k).tolist()]
                    assert started_s == row.started_s
                    assert [vars(each) | {"counts": each.counts.tolist()} for each in here] == [
                        vars(each) | {"counts": each.counts.tolist()} for each in row.readings
                    ]
            assert next(found, None) is None


def test_readings_beyond_the_memory_for_them_are_read_again(tmp_path: Path) -> None:
    write_long_journal(tmp_path / "a.journal", 2, 2)
    found = []
    for most in (10**9, 100):
        with Journal.open(tmp_path / "a.journal", BlockSizes(kept_bytes=most)) as journal:
            assert (journal.all_recorded(most, "measure") is None) == (most == 100)
            found.append(reduce_journal(journal).samples["gaussian-5"])
    one, other = found
    assert np.array_equal(one.places, other.places)
    assert one.columns().keys() == other.columns().keys()
    for name, column in one.columns().items():
        assert np.array_equal(column, other.columns()[name], equal_nan=True), name


@pytest.mark.parametrize("shape", [(-1, -4), (1 << 62, 8)], ids=["negative", "larger than any"])
def test_counts_of_a_shape_that_cannot_be_are_damage(shape: tuple[int, int]) -> None:
    """Where the product of the two is right all the same: of two negative numbers, or of one that does not fit in 64 bits."""
    counts = bytes(2 * shape[0] * shape[1] % (1 << 64))
    with pytest.raises(ValueError, match=r"row 7 has .* bytes of counts"):
        columns_of_readings([(7, 0.0, 1e8, 0.0, 0.08, 1e-9, *shape, counts)])
