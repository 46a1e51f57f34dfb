"""The pieces that need no window: the clock's pace, the journals' names, colours, words."""

import threading
from pathlib import Path

import pytest

from goniotwin.app.desktop.model.rig_thread import next_journal
from goniotwin.app.desktop.model.scaled_clock import PacedClock
from goniotwin.app.desktop.run.panel import in_words
from goniotwin.app.desktop.theme import DARK, LIGHT, Colours


def test_a_change_of_pace_is_no_jump_and_wakes_whoever_sleeps() -> None:
    clock = PacedClock(1.0)
    sleeper = threading.Thread(target=lambda: clock.sleep_until(3600.0))
    sleeper.start()
    before = clock.now()
    clock.set_speed(1e6)
    assert 0.0 <= before < 3600.0
    sleeper.join(timeout=10.0)
    assert not sleeper.is_alive()
    fast = clock.now()
    clock.set_speed(1e-3)
    assert clock.now() >= fast >= 3600.0


def test_an_action_at_a_time_heeds_the_pace_and_can_be_cancelled() -> None:
    clock = PacedClock(1.0)
    done, cancelled = threading.Event(), threading.Event()
    clock.at(7200.0, done.set)
    clock.at(3600.0, cancelled.set).cancel()
    clock.set_speed(1e6)
    assert done.wait(10.0)
    assert not cancelled.is_set()
    with pytest.raises(ValueError, match="positive"):
        clock.set_speed(0.0)


def test_no_journal_gets_a_name_that_another_has(tmp_path: Path) -> None:
    assert next_journal(tmp_path, "quick") == tmp_path / "quick-001.journal"
    (tmp_path / "quick-009.journal").touch()
    (tmp_path / "quick-old.journal").touch()
    (tmp_path / "quicker-050.journal").touch()
    assert next_journal(tmp_path, "quick") == tmp_path / "quick-010.journal"
    (tmp_path / "quick-999.journal").touch()
    assert next_journal(tmp_path, "quick") == tmp_path / "quick-1000.journal"


@pytest.mark.parametrize(
    ("name", "stem"), [("a b: c?", "a-b-c"), ("..", "campaign"), ("Ölfarbe σ", "Ölfarbe-σ"), ("x.y", "x.y")]
)
def test_a_schedule_may_have_a_name_that_no_file_can_have(tmp_path: Path, name: str, stem: str) -> None:
    assert next_journal(tmp_path, name).name == f"{stem}-001.journal"


@pytest.mark.parametrize("colours", [LIGHT, DARK], ids=["light", "dark"])
def test_text_has_the_contrast_that_wcag_asks_for(colours: Colours) -> None:
    """WCAG 2.2, 1.4.3: at least 4.5 to 1."""
    grounds = (colours.window, colours.base)
    for text in (colours.text, colours.dim, colours.good, colours.bad):
        for ground in grounds:
            assert contrast(text, ground) >= 4.5, (text, ground)
    assert contrast(colours.on_simulated, colours.simulated) >= 4.5
    assert contrast("#ffffff", colours.stop) >= 4.5
    assert contrast(colours.on_accent, colours.accent) >= 4.5
    # WCAG 2.2, 1.4.11: what carries meaning without being text, 3 to 1.
    for mark in (colours.points, colours.hidden):
        assert contrast(mark, colours.base) >= 3.0


def contrast(one: str, other: str) -> float:
    """WCAG 2.2, contrast ratio."""
    brighter, darker = sorted((luminance(one), luminance(other)), reverse=True)
    return (brighter + 0.05) / (darker + 0.05)


def luminance(colour: str) -> float:
    """WCAG 2.2, relative luminance."""
    parts = [int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize(
    ("seconds", "text"), [(4.4, "4 s"), (59.7, "1 min 00 s"), (125.0, "2 min 05 s"), (11220.0, "3 h 07 min")]
)
def test_durations_in_words(seconds: float, text: str) -> None:
    assert in_words(seconds) == text
