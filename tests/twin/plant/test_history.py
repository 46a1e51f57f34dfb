"""What was when."""

from goniotwin.twin.plant.history import History


def test_the_past_is_known() -> None:
    line = History("a")
    line.set(1.0, "b")
    line.set(2.0, "c")
    assert [line.at(t) for t in (0.0, 1.0, 1.9, 2.0, 9.0)] == ["a", "b", "b", "c", "c"]
    assert line.before(2.5) == ("b", 0.5)
    assert line.before(1.5) == ("a", 0.5)


def test_a_new_command_takes_back_what_was_to_come() -> None:
    line = History(0.0)
    line.set(5.0, 500.0)
    line.set(3.0, 300.0)
    assert line.at(10.0) == 300.0


def test_memory_is_bounded() -> None:
    line = History(0, keep=8)
    for k in range(1000):
        line.set(float(k), k)
    assert line.at(999.0) == 999
    assert line.at(0.0) == 992  # the oldest kept
