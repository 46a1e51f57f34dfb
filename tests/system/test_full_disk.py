"""A disk that is full in the middle of a campaign: one error line, all committed rows are kept, and it can be resumed."""

import contextlib
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.lock import RigInUse, RigLock
from goniotwin.mocks.control import ControlClient
from tests.app.campaign.campaign_bench import QUIET, THREE_SHIFTS, planned_values
from tests.conftest import Writer
from tests.system.command_process import FORKED, CommandProcess, Limits, check_committed
from tests.system.conftest import ForkedServe, control_client
from tests.system.full_disks import (
    HEADING,
    as_row,
    bytes_needed,
    on_a_disk,
    sizes_of_disks,
    small_disks,
    with_a_limit,
    writings,
)

pytestmark = FORKED
SPEED = 10
MAX_TRIES = 8
TOO_FEW_BYTES = (5_000, 20_000, 40_000, 60_000)
MIN_BYTES, MAX_BYTES = 80_000, 110_000
"""Limits of the file size: below it no journal can be created, above it the whole campaign has room."""
MIN_KB, MAX_KB = 176, 196
"""The same limits for the size of a disk."""
FreeSpace = Callable[[], object]
SmallDisk = Callable[..., Path]


@dataclass
class Bench:
    """A served rig, a campaign for it, and the journal of an undisturbed run."""

    folder: Path
    schedule: Path
    rig: Path
    control: ControlClient
    undisturbed: Path

    def fail_and_resume(self, path: Path, limits: Limits, free_space: FreeSpace, remedy: str) -> int:
        """Start a campaign without enough space, resume it with enough; return the number of rows before the disk was full.

        `remedy` is the end of the error.
        """
        for _ in range(MAX_TRIES):
            process = CommandProcess(self.folder, "run", self.schedule, "--rig", self.rig, "--out", path, limits=limits)
            status = process.wait()
            if "cannot be written" in process.errors:
                break
            remove(path)  # the answer of a device came too late on a busy machine
        assert status == 1, process.errors
        (line,) = (line for line in process.error_lines if "cannot be written" in line)
        assert f"{path}: cannot be written: " in line
        assert line.endswith(f"; {remedy}")
        assert process.errors.splitlines()[-1] == f"to continue: goniotwin run --resume {path}"
        assert self._at_rest()
        check_committed(path, process.committed)
        assert campaign_summary(path).rows == len(process.committed)
        free_space()
        for _ in range(MAX_TRIES):
            resumed = CommandProcess(self.folder, "run", "--resume", path)
            if resumed.wait() == 0:
                break
        check_committed(path, process.committed | resumed.committed)
        assert planned_values(path) == planned_values(self.undisturbed), resumed.errors
        return len(process.committed)

    def _at_rest(self) -> bool:
        """Whether the axes are at rest, before the heartbeat would have stopped them."""
        before = self.control.do("state")
        after = self.control.do("state")
        return bool(before["angles_deg"] == after["angles_deg"] and before["t_s"] < after["t_s"])


def remove(path: Path) -> None:
    """Delete a journal and the files beside it."""
    for each in path.parent.glob(f"{path.name}*"):
        each.unlink()


@pytest.fixture
def bench(write_rig: Writer, write_schedule: Writer, forked_serve: ForkedServe, tmp_path: Path) -> Iterator[Bench]:
    here, there, schedule = write_rig(*QUIET), tmp_path / "served.toml", write_schedule(THREE_SHIFTS)
    lines = forked_serve(here, "--speed", SPEED, "--write-rig", there)
    run_campaign(make_plan(read_schedule(schedule), read_rig(here)), tmp_path / "undisturbed.journal")
    control = control_client(lines)
    yield Bench(tmp_path, schedule, there, control, tmp_path / "undisturbed.journal")
    control.close()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[SmallDisk]:
    """Mount a disk of a size in kB, or change its size or permissions; skip the test where mounting is not permitted."""
    place = tmp_path / "disk"
    place.mkdir()

    def resize(kilobytes: int, permissions: str = "rw") -> Path:
        options = f"size={kilobytes}k,{permissions}" + (",remount" if place.is_mount() else "")
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", str(place)], capture_output=True, check=False)
        if done.returncode != 0:
            pytest.skip("mounting a disk is not permitted here")
        return place

    yield resize
    if place.is_mount():
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.long
@pytest.mark.parametrize("sizes", [25])
def test_a_campaign_fails_at_a_limit_of_the_file_size_and_resumes_without_it(bench: Bench, sizes: int) -> None:
    """A limit of the file size acts as a full disk, where a small disk cannot be mounted."""
    found = []
    for size in np.linspace(MAX_BYTES, MIN_BYTES, sizes)[::-1]:
        path = bench.folder / f"{size:.0f}.journal"
        remedy = "check the disk, its permissions and any limit of the size of files"  # the disk itself has space
        found.append(bench.fail_and_resume(path, Limits(file_bytes=int(size)), lambda: None, remedy))
    assert found == sorted(found)
    assert found[-1] > 0
    assert found[0] < found[-1]
    print(f"\nrows before the disk was full: {found}")


@pytest.mark.long
@pytest.mark.parametrize("sizes", [13])
def test_a_campaign_fails_on_a_full_disk_and_resumes_with_free_space(bench: Bench, small_disk: SmallDisk, sizes: int) -> None:
    found = []
    for size in np.linspace(MIN_KB, MAX_KB, sizes):
        path = small_disk(int(size)) / f"{size:.0f}.journal"
        found.append(bench.fail_and_resume(path, Limits(), lambda: small_disk(MAX_KB * 10), "free space on the disk"))
        remove(path)
    print(f"\nrows before the disk was full: {found}")


@pytest.mark.parametrize("file_bytes", TOO_FEW_BYTES)
def test_without_space_for_a_journal_no_file_is_left(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, file_bytes: int
) -> None:
    folder = tmp_path / "journals"
    folder.mkdir()
    path = folder / "a.journal"
    process = CommandProcess(
        tmp_path, "run", write_schedule(), "--rig", write_rig(), "--out", path, limits=Limits(file_bytes=file_bytes)
    )
    assert process.wait() == 2
    (line,) = process.error_lines
    assert f"{path}: cannot be written: " in line
    assert line.endswith("; check the folder and the disk")
    assert list(folder.iterdir()) == []


QUICK = ("ddr", "csv", "archive", "archive of a journal")
"""Files that stand for the others here: a table with the files beside it, lines, HDF5."""


@pytest.mark.long
def test_a_file_without_room_is_one_line_and_status_2_and_leaves_nothing(tmp_path: Path) -> None:
    """With 5000 bytes: each needs twice as many, or more. HDF5 ends in a segmentation fault where it cannot write."""
    folder = tmp_path / "files"
    folder.mkdir()
    outcomes = [with_a_limit(each, 5000, folder, tmp_path) for each in writings(tmp_path) if each.name in QUICK]
    assert [(each.writing, each.fault) for each in outcomes if each.fault or each.status != 2] == []
    assert len(outcomes) == len(QUICK)


@pytest.mark.long
@pytest.mark.parametrize("sizes", [50])
def test_files_on_disks_of_many_sizes_are_whole_or_not_there(tmp_path: Path, sizes: int) -> None:
    """On small disks, or, where mounting is not permitted, with limits of the size of a file."""
    free, place = tmp_path / "free", tmp_path / "disk"
    free.mkdir()
    place.mkdir()
    faults = []
    print(f"\n{HEADING}")
    with small_disks(place) as disk:
        for writing in writings(tmp_path):
            outcomes = [
                on_a_disk(writing, size, disk, tmp_path) if disk else with_a_limit(writing, size, free, tmp_path)
                for size in sizes_of_disks(bytes_needed(writing, free, tmp_path), sizes)
            ]
            print(as_row(outcomes))
            faults += [each for each in outcomes if each.fault]
    assert faults == []


def test_on_a_full_disk_a_rig_is_locked_without_the_name_of_the_holder(small_disk: SmallDisk) -> None:
    folder = small_disk(MIN_KB)
    with contextlib.suppress(OSError), (folder / "filled").open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    lock = RigLock(["/dev/ttyUSB0"], "measuring paint", folder / "locks")
    with pytest.raises(RigInUse, match="is in use by another program"):
        RigLock(["/dev/ttyUSB0"], "measuring wood", folder / "locks")
    lock.release()
    RigLock(["/dev/ttyUSB0"], "measuring wood", folder / "locks").release()


def test_a_killed_campaign_on_a_read_only_disk_can_be_read(
    write_rig: Writer, write_schedule: Writer, small_disk: SmallDisk, tmp_path: Path
) -> None:
    """SQLite alone cannot read it there: with a -wal file it needs to create another file."""
    path = small_disk(MAX_KB * 10) / "a.journal"
    killed = CommandProcess(tmp_path, "run", write_schedule(), "--rig", write_rig(), "--out", path, limits=Limits(rows=4))
    assert killed.wait() < 0
    Path(f"{path}-shm").unlink()
    small_disk(MAX_KB * 10, "ro")
    check_committed(path, killed.committed)
    campaign = campaign_summary(path)
    assert (campaign.state, campaign.rows) == ("killed", 4)
