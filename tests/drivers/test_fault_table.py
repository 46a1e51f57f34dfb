"""Every fault on every wire, one at a time: the table of `python -m benchmarks.fault_table`."""

import pytest

from goniotwin.mocks.faults import Fault
from tests.drivers.fault_benches import BENCHES, FaultBench
from tests.drivers.fault_table import AGAIN, ERROR, NOTICED, RIGHT, STUCK, WRONG, Cell, as_markdown, case, failures, table


@pytest.mark.parametrize("kind", BENCHES)
def test_no_single_fault_gives_a_wrong_value_or_a_stuck_driver(kind: type[FaultBench]) -> None:
    for number, fault in enumerate(kind.faults):
        tolerated = (WRONG,) if fault in kind.undetectable else ()
        assert case(kind, fault, number, Cell()) in (RIGHT, AGAIN, ERROR, NOTICED, *tolerated)


@pytest.mark.parametrize("kind", BENCHES)
def test_a_reset_is_detected(kind: type[FaultBench]) -> None:
    assert case(kind, Fault.RESET, 1, Cell()) == NOTICED


def test_wrong_values_and_stuck_drivers_are_reported_as_failures() -> None:
    axes, _, over_tcp, *_ = BENCHES
    rows = {fault: {kind: Cell() for kind in (axes, over_tcp)} for fault in (Fault.LOST, Fault.CORRUPTED)}
    assert failures(rows) == []
    rows[Fault.CORRUPTED][over_tcp].outcomes[WRONG] = 1  # undetectable on this wire
    assert failures(rows) == []
    rows[Fault.CORRUPTED][axes].outcomes[WRONG] = 2
    rows[Fault.LOST][over_tcp].outcomes[STUCK] = 3
    assert failures(rows) == ["photodiodes (Modbus TCP), reply lost: STUCK 3", "axes (TMCL), corrupted reply: WRONG 2"]
    assert "| corrupted reply | WRONG 2 | WRONG 1 † |" in as_markdown(rows)


@pytest.mark.long
def test_a_hundred_cases_of_each_fault_on_each_wire(capsys: pytest.CaptureFixture[str]) -> None:
    rows = table(100)
    with capsys.disabled():
        print(f"\n{as_markdown(rows)}")
    assert failures(rows) == []
