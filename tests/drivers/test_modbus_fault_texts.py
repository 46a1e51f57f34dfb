"""Texts for faults of a Modbus wire."""

import pytest
from pymodbus.exceptions import ConnectionException, ModbusIOException

from goniotwin.drivers.photodiodes.modbus import describe_fault


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (
            ModbusIOException("ERROR: No response received of the last requests (default: retries+3), CLOSING CONNECTION."),
            "not responding",
        ),
        (ModbusIOException("No response received after 0 retries, continue with next request"), "not responding"),
        (ModbusIOException("ERROR: request uses device id=1 but received 2."), "request uses device id=1 but received 2."),
        (
            ConnectionException("Client cannot connect (automatic retry continuing) !!"),
            "no connection",
        ),
        (OSError("broken pipe"), "broken pipe"),
        (ValueError(), "ValueError"),
    ],
)
def test_a_wire_fault_is_described_without_advice_to_programmers(error: Exception, text: str) -> None:
    assert describe_fault(error) == text
