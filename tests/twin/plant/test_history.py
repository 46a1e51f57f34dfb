"""History of a quantity: values in the past, overwritten values, limited memory."""

from goniotwin.twin.plant.history import History


def test_values_at_earlier_times_are_available() -> None:
    line = History("a")
    line.set(1.0, "b")
    line.set(2.0, "c")
    assert [line.at(t) for t in (0.0, 1.0, 1.9, 2.0, 9.0)] == ["a", "b", "b", "c", "c"]
    assert line.before(2.5) == ("b", 0.5)
    assert line.before(1.5) == ("a", 0.5)


def test_a_new_value_replaces_values_set_for_later_times() -> None:
    line = History(0.0)
    line.set(5.0, 500.0)
    line.set(3.0, 300.0)
    assert line.at(10.0) == 300.0


def test_the_number_of_stored_values_is_limited() -> None:
    line = History(0, keep=8)
    for k in range(1000):
        line.set(float(k), k)
    assert line.at(999.0) == 999
    assert line.at(0.0) == 992  # the oldest stored value
