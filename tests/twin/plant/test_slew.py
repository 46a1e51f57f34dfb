"""Quantity that changes linearly from one value to another."""

from goniotwin.twin.plant.history import SlewHistory


def test_a_slew_is_linear_and_can_be_stopped() -> None:
    line = SlewHistory(500.0)
    assert line.last_change == float("-inf")
    line.slew(10.0, 12.0, 600.0)
    assert [line.at(t) for t in (0.0, 10.0, 11.0, 12.0, 20.0)] == [500.0, 500.0, 550.0, 600.0, 600.0]
    assert line.last_change == 12.0
    line.stop(11.5)
    assert [line.at(t) for t in (11.0, 11.5, 20.0)] == [550.0, 575.0, 575.0]
    assert line.last_change == 11.5
