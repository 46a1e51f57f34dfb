"""A disk that is full in the middle of a campaign: it fails in one line, everything told is there, and with room it goes on."""

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
from goniotwin.app.rig.lock import Held, RigLock
from goniotwin.mocks.control import Control
from tests.app.campaign.test_resume import MORE, STEADY, values
from tests.conftest import Writer
from tests.system.conftest import Serve, at
from tests.system.killable import FORKED, Fate, Killable, check_told

pytestmark = FORKED
SPEED = 10
MOST_TRIES = 8
TOO_LITTLE_BYTES = (5_000, 20_000, 40_000, 60_000)
LEAST_BYTES, MOST_BYTES = 70_000, 190_000
"""Of the longest file: below there is no room for a journal, above for the whole campaign."""
LEAST_KB, MOST_KB = 176, 248
"""The same of a whole disk."""
MakeRoom = Callable[[], object]
SmallDisk = Callable[..., Path]


@dataclass
class Bench:
    """A served rig, a campaign for it, and what it comes to undisturbed."""

    folder: Path
    schedule: Path
    rig: Path
    control: Control
    undisturbed: Path

    def fail_and_go_on(self, path: Path, fate: Fate, make_room: MakeRoom) -> int:
        """Begins a campaign for which there is no room, and finishes it when there is; how many rows had room."""
        for _ in range(MOST_TRIES):
            process = Killable(self.folder, "run", self.schedule, "--rig", self.rig, "--out", path, fate=fate)
            status = process.ended()
            if "cannot be written" in process.errors:
                break
            remove(path)  # a device's answer came too late, on a machine that is busy elsewhere
        assert status == 1, process.errors
        (complaint,) = (line for line in process.complaints if "cannot be written" in line)
        assert f"{path}: cannot be written: " in complaint
        assert complaint.endswith("; free space on the disk")
        assert process.errors.splitlines()[-1] == f"to continue: goniotwin run --resume {path}"
        assert self._at_rest()
        check_told(path, process.told)
        assert campaign_summary(path).rows == len(process.told)
        make_room()
        for _ in range(MOST_TRIES):
            resumed = Killable(self.folder, "run", "--resume", path)
            if resumed.ended() == 0:
                break
        check_told(path, process.told | resumed.told)
        assert values(path) == values(self.undisturbed), resumed.errors
        return len(process.told)

    def _at_rest(self) -> bool:
        """Well before its heartbeat would have stopped them."""
        before = self.control.do("state")
        after = self.control.do("state")
        return bool(before["angles_deg"] == after["angles_deg"] and before["t_s"] < after["t_s"])


def remove(path: Path) -> None:
    """A journal, with what belongs to it."""
    for each in path.parent.glob(f"{path.name}*"):
        each.unlink()


@pytest.fixture
def bench(write_rig: Writer, write_schedule: Writer, serve: Serve, tmp_path: Path) -> Iterator[Bench]:
    here, there, schedule = write_rig(*STEADY), tmp_path / "served.toml", write_schedule(MORE)
    _, lines = serve(here, "--speed", SPEED, "--write-rig", there)
    run_campaign(make_plan(read_schedule(schedule), read_rig(here)), tmp_path / "undisturbed.journal")
    control = Control(at(lines, "control", "port")["port"])
    yield Bench(tmp_path, schedule, there, control, tmp_path / "undisturbed.journal")
    control.close()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[SmallDisk]:
    """Mounts a disk of so many kB, or gives it another size or rights; skips the test where nobody may."""
    place = tmp_path / "disk"
    place.mkdir()

    def sized(kilobytes: int, rights: str = "rw") -> Path:
        options = f"size={kilobytes}k,{rights}" + (",remount" if place.is_mount() else "")
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", str(place)], capture_output=True, check=False)
        if done.returncode != 0:
            pytest.skip("nobody may mount a small disk here")
        return place

    yield sized
    if place.is_mount():
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("sizes", [pytest.param(2, id="2"), pytest.param(25, id="25", marks=pytest.mark.long)])
def test_where_the_journal_may_not_grow_the_campaign_fails_and_goes_on_when_it_may(bench: Bench, sizes: int) -> None:
    """A bound for the size of files: how a full disk looks where nobody may make a small one."""
    found = []
    for size in np.linspace(LEAST_BYTES, MOST_BYTES, sizes):
        path = bench.folder / f"{size:.0f}.journal"
        found.append(bench.fail_and_go_on(path, Fate(most_bytes=int(size)), lambda: None))
    assert found == sorted(found)
    assert found[0] < found[-1]
    print(f"\nrows that had room: {found}")


@pytest.mark.parametrize("sizes", [pytest.param(1, id="1"), pytest.param(13, id="13", marks=pytest.mark.long)])
def test_when_the_disk_is_full_the_campaign_fails_and_goes_on_when_there_is_room(
    bench: Bench, small_disk: SmallDisk, sizes: int
) -> None:
    found = []
    for size in np.linspace(LEAST_KB, MOST_KB, sizes):
        path = small_disk(int(size)) / f"{size:.0f}.journal"
        found.append(bench.fail_and_go_on(path, Fate(), lambda: small_disk(MOST_KB * 10)))
        remove(path)
    print(f"\nrows that had room: {found}")


@pytest.mark.parametrize("most", TOO_LITTLE_BYTES)
def test_where_there_is_no_room_for_a_journal_nothing_is_left_of_it(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, most: int
) -> None:
    folder = tmp_path / "journals"
    folder.mkdir()
    path = folder / "a.journal"
    process = Killable(tmp_path, "run", write_schedule(), "--rig", write_rig(), "--out", path, fate=Fate(most_bytes=most))
    assert process.ended() == 2
    (complaint,) = process.complaints
    assert f"{path}: cannot be written: " in complaint
    assert complaint.endswith("; check the folder and the disk")
    assert list(folder.iterdir()) == []


def test_on_a_full_disk_a_rig_is_held_without_a_note_of_who_has_it(small_disk: SmallDisk) -> None:
    folder = small_disk(LEAST_KB)
    with contextlib.suppress(OSError), (folder / "filled").open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    lock = RigLock(["/dev/ttyUSB0"], "measuring paint", folder / "locks")
    with pytest.raises(Held, match="is in use by another program"):
        RigLock(["/dev/ttyUSB0"], "measuring wood", folder / "locks")
    lock.release()
    RigLock(["/dev/ttyUSB0"], "measuring wood", folder / "locks").release()


def test_on_a_disk_that_may_only_be_read_a_killed_campaign_says_what_it_has(
    write_rig: Writer, write_schedule: Writer, small_disk: SmallDisk, tmp_path: Path
) -> None:
    """SQLite could not read it there: with a -wal file beside it, it wants another."""
    path = small_disk(MOST_KB * 10) / "a.journal"
    killed = Killable(tmp_path, "run", write_schedule(), "--rig", write_rig(), "--out", path, fate=Fate(rows=4))
    assert killed.ended() < 0
    Path(f"{path}-shm").unlink()
    small_disk(MOST_KB * 10, "ro")
    check_told(path, killed.told)
    campaign = campaign_summary(path)
    assert (campaign.state, campaign.rows) == ("killed", 4)
