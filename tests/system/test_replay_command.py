"""`goniotwin replay`: transcripts of a rig, and where the answers of the twin differ."""

import json
import re
import shutil
from pathlib import Path

import pytest
from pymodbus.framer import FramerRTU

from goniotwin.app.cli.work.replay import ReplayResult, replay_transcripts
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.mocks.transcript import read_transcript
from tests.conftest import Change, Writer
from tests.mocks.replay_bench import RTU, TCP, RigMaker, session, virtual
from tests.mocks.replay_bench import rig_of as rig_of
from tests.system.command import CALLS, Call

# Units 20 to 24, where the twin's are 1 to 5.
REAL_LINE: tuple[Change, ...] = tuple((f'"twin://virtual/adc-{k}"', f'"rtu:COM7?unit={k + 20}"') for k in range(5))


@pytest.fixture
def recorded(rig_of: RigMaker, tmp_path: Path) -> Path:
    """The transcripts of a session with a sample mounted."""
    rig = rig_of(*TCP, transcript=tmp_path / "wires")
    virtual(rig).mount("gaussian-5")
    session(rig.rig)
    rig.close()
    return tmp_path / "wires"


def replayed(
    write_rig: Writer, folder: Path, *changes: Change, stem: str = "*", mount: str | None = "gaussian-5"
) -> ReplayResult:
    return replay_transcripts(sorted(folder.glob(f"{stem}.txt")), read_rig(write_rig(*changes)), None, mount)


@pytest.mark.parametrize("call", CALLS)
def test_a_twin_of_the_same_rig_has_no_difference(recorded: Path, write_rig: Writer, call: Call) -> None:
    rig = write_rig(*TCP)
    done = call("replay", *sorted(recorded.iterdir()), "--rig", rig, "--mount", "gaussian-5")
    assert (done.returncode, done.stderr) == (0, "")
    (line,) = done.stdout.splitlines()
    assert re.match(r"no difference in \d+ requests: ", line)
    assert line.endswith(": axes.txt, monitor.txt, monochromator.txt, " + ", ".join(f"photodiodes-{k}.txt" for k in range(5)))


@pytest.mark.parametrize("call", CALLS)
def test_each_difference_is_listed_byte_by_byte_with_status_1(recorded: Path, write_rig: Writer, call: Call) -> None:
    done = call("replay", recorded / "monitor.txt", "--rig", write_rig(*TCP))  # recorded with light, replayed without
    assert (done.returncode, done.stderr) == (1, "")
    first, request, was, now, last = done.stdout.splitlines()
    byte = r"byte \d+: [0-9a-f]{2} recorded, [0-9a-f]{2} now"
    assert re.fullmatch(rf"monitor.txt, line \d+, from the device: {byte}(; {byte})*", first)
    assert re.fullmatch(r" +request +02 .* 00  \| transfer \d+: up to 4096 bytes requested", request)
    assert re.fullmatch(r" +recorded +02 .*  \| transfer \d+: '1\.\d{8}E-07\\n'", was)
    assert re.fullmatch(r" +now +02 .*  \| transfer \d+: '1\.\d{8}E-11\\n'", now)
    assert re.fullmatch(r"1 difference in \d+ requests: monitor.txt", last)


@pytest.mark.parametrize("call", CALLS)
def test_json_output_is_one_object(recorded: Path, write_rig: Writer, call: Call) -> None:
    renamed = recorded.parent / "answers of the axes.txt"
    shutil.copy(recorded / "axes.txt", renamed)
    done = call("replay", renamed, "--device", "axes", "--rig", write_rig(*TCP), "--json")
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads(done.stdout)
    assert result["transcripts"] == {"answers of the axes.txt": "axes"}
    assert result["told"] > 50
    assert result["differences"] == []


def test_json_output_has_the_numbers_of_the_bytes_that_differ(recorded: Path, write_rig: Writer) -> None:
    result = replayed(write_rig, recorded, *TCP, stem="photodiodes-0").as_dict()
    first = result["differences"][0]  # a reading without light: the transcript of the shutter is missing
    assert first["file"] == "photodiodes-0.txt"
    was, now = (bytes.fromhex(first[key]) for key in ("recorded", "now"))
    assert first["bytes"] == [{"at": at, "recorded": was[at], "now": now[at]} for at in range(len(was)) if was[at] != now[at]]


def test_transcripts_that_are_replayed_together_share_one_plant(recorded: Path, write_rig: Writer) -> None:
    assert not replayed(write_rig, recorded, *TCP).differences
    assert replayed(write_rig, recorded, *TCP, stem="photodiodes-0").differences
    assert replayed(write_rig, recorded, *TCP, mount=None).differences


def test_units_of_a_real_line_are_found_by_their_numbers(rig_of: RigMaker, write_rig: Writer, tmp_path: Path) -> None:
    rig = rig_of(*RTU, transcript=tmp_path)
    rig.rig.photodiodes.connect()
    rig.close()
    assert not replayed(write_rig, tmp_path, *RTU, stem="photodiodes-*").differences
    silent = replayed(write_rig, tmp_path, *RTU, *REAL_LINE, stem="photodiodes-*")
    assert {each.replayed for each, _ in silent.differences} == {b""}
    for path in tmp_path.glob("photodiodes-*.txt"):
        readdress(path, 19)
    assert not replayed(write_rig, tmp_path, *RTU, *REAL_LINE, stem="photodiodes-*").differences


def readdress(path: Path, more: int) -> None:
    """Add a number to the unit number of every RTU frame of a transcript."""
    lines = []
    for each in read_transcript(path):
        body = bytes((each.data[0] + more,)) + each.data[1:-2]
        frame = body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
        lines.append(f"{each.t:.6f} {each.direction} {frame.hex(' ')}  | \n")
    path.write_text("".join(lines), encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "text", "device", "message"),
    [
        ("axes.txt", "no transcript", None, "axes.txt, line 1: "),
        ("axes.txt", "# nothing\n", None, "axes.txt: has no bytes"),
        (
            "notes.txt",
            " 1.0 > 01  | \n",
            None,
            "notes.txt: the file name is not a device of .*: axes, monochromator, photodiodes-0, ",
        ),
        ("photodiodes-5.txt", " 1.0 > 01  | \n", None, "photodiodes-5.txt: the file name is not a device"),
        ("axes.txt", " 1.0 > 01  | \n", "arm", "has no device 'arm'; it has axes, "),
    ],
)
def test_a_file_or_device_that_cannot_be_replayed_is_refused(
    write_rig: Writer, tmp_path: Path, name: str, text: str, device: str | None, message: str
) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=message):
        replay_transcripts([path], read_rig(write_rig()), device, None)


def test_wrong_combinations_of_options_are_refused(recorded: Path, write_rig: Writer) -> None:
    rig, axes = read_rig(write_rig()), recorded / "axes.txt"
    with pytest.raises(UserError, match="no sample 'gold'; it has: etalon, gaussian-5"):
        replay_transcripts([axes], rig, None, "gold")
    with pytest.raises(UserError, match="there is another transcript of axes"):
        replay_transcripts([axes, axes], rig, None, None)
    with pytest.raises(UserError, match="--device is for one transcript, and there are 2"):
        replay_transcripts([axes, recorded / "monitor.txt"], rig, "axes", None)
    with pytest.raises(UserError, match="cannot be read"):
        replay_transcripts([recorded / "none" / "axes.txt"], rig, None, None)


@pytest.mark.parametrize("call", CALLS)
def test_bad_input_is_one_line_with_status_2(recorded: Path, write_rig: Writer, call: Call) -> None:
    done = call("replay", write_rig(name="axes.txt"), "--rig", write_rig())
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("goniotwin: ")
    assert "axes.txt, line 2: is no line of a transcript" in line
