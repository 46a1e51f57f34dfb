"""All wires of a rig at once: the recording of one rig, replayed to another rig and to the drivers of another."""

from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.rig import read_rig
from goniotwin.mocks.replay import LineReplay, RecordedDevice, Replay, replay_all
from goniotwin.mocks.replay_usb import RecordedUsb, UsbReplay
from goniotwin.mocks.transcript import Transfer
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.modbus import TcpStation
from tests.conftest import RIG
from tests.mocks.replay_bench import RigMaker, same, session, transcripts, virtual
from tests.mocks.replay_bench import rig_of as rig_of

STEMS = ("axes", "monochromator", "monitor", "photodiodes")


def record(rig_of: RigMaker, folder: Path) -> dict[str, list[list[Transfer]]]:
    rig = rig_of(transcript=folder)
    session(rig.rig)
    rig.close()
    return {stem: transcripts(folder, stem) for stem in STEMS}


def wires(rig: VirtualRig, recorded: dict[str, list[list[Transfer]]]) -> list[Replay]:
    return [
        LineReplay(rig.serial["axes"], recorded["axes"][0]),
        LineReplay(rig.serial["mono"], recorded["monochromator"][0]),
        UsbReplay(rig.usb["monitor"], recorded["monitor"][0]),
        *(
            LineReplay(TcpStation(module), transcript, 0.5 * module.latency_s)
            for module, transcript in zip(rig.modbus.values(), recorded["photodiodes"], strict=True)
        ),
    ]


def test_a_twin_with_the_same_seed_gives_the_same_answers_with_noise(rig_of: RigMaker, tmp_path: Path) -> None:
    replays = wires(virtual(rig_of()), record(rig_of, tmp_path))
    replay_all(replays)
    assert [each.differences() for each in replays] == [[]] * len(replays)


def test_the_drivers_do_the_same_again_on_recorded_devices(rig_of: RigMaker, tmp_path: Path) -> None:
    # All but the monochromator's: its driver leaves the end of a line unread until it next has to do with it.
    recorded = record(rig_of, tmp_path / "first")
    again = rig_of(transcript=tmp_path / "again")
    rig = virtual(again)
    way_s = 0.5 * rig.modbus["adc-0"].latency_s
    axes = rig.serial["axes"] = RecordedDevice(recorded["axes"][0], rig.serial["axes"].baudrate)
    monitor = rig.usb["monitor"] = RecordedUsb(rig.usb["monitor"], recorded["monitor"][0])
    modules = [RecordedDevice(each, way_s=way_s) for each in recorded["photodiodes"]]
    for index, module in enumerate(modules):
        rig.modbus_wires[f"adc-{index}"] = lambda station, module=module: module  # type: ignore[misc]
    session(again.rig)
    again.close()
    devices: list[RecordedDevice | RecordedUsb] = [axes, monitor, *modules]
    assert [each.differences for each in devices] == [[]] * len(devices)
    assert all(each.finished for each in devices)
    for stem in STEMS:
        for one, other in zip(recorded[stem], transcripts(tmp_path / "again", stem), strict=True):
            assert same(one, other, 0.0)


MODEL = read_rig(RIG).model()
ANYTHING = st.lists(
    st.builds(
        Transfer,
        st.floats(-1e9, 1e9),
        st.sampled_from("<>"),
        st.one_of(st.binary(min_size=1, max_size=24), st.binary(min_size=8, max_size=9)),
        st.integers(1, 99),
    ),
    max_size=6,
)


@settings(deadline=None)
@given(ANYTHING)
def test_any_transcript_can_be_replayed_to_any_device(transcript: list[Transfer]) -> None:
    assert MODEL is not None
    rig = VirtualRig.build(MODEL, VirtualClock())
    anywhere = {"axes": [transcript], "monochromator": [transcript], "monitor": [transcript], "photodiodes": [transcript] * 5}
    replays = wires(rig, anywhere)
    replay_all(replays)
    for each in replays:
        assert all(difference.places for difference in each.differences())
