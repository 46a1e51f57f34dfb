"""Parts that need no window: the clock, the names of journals, colours, texts."""

import threading
from pathlib import Path

import pytest

from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.theme import DARK, LIGHT, Colours
from goniotwin.app.figures.description import ColourMap
from goniotwin.app.figures.hemisphere import colour_table
from goniotwin.app.figures.style import DISC, MARKS, PAPER, Palette
from goniotwin.app.station.runs import next_journal
from goniotwin.protocols.clock import ScaledClock


def test_a_change_of_speed_is_continuous_and_wakes_a_sleeping_thread() -> None:
    clock = ScaledClock(1.0)
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


def test_a_timed_action_follows_the_speed_and_can_be_cancelled() -> None:
    clock = ScaledClock(1.0)
    done, cancelled = threading.Event(), threading.Event()
    clock.at(7200.0, done.set)
    clock.at(3600.0, cancelled.set).cancel()
    clock.set_speed(1e6)
    assert done.wait(10.0)
    assert not cancelled.is_set()
    with pytest.raises(ValueError, match="positive"):
        clock.set_speed(0.0)


def test_a_journal_never_gets_the_name_of_another(tmp_path: Path) -> None:
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
def test_characters_that_a_file_name_cannot_have_are_replaced(tmp_path: Path, name: str, stem: str) -> None:
    assert next_journal(tmp_path, name).name == f"{stem}-001.journal"


@pytest.mark.parametrize("colours", [LIGHT, DARK], ids=["light", "dark"])
def test_colours_have_the_contrast_that_wcag_requires(colours: Colours) -> None:
    """WCAG 2.2, 1.4.3: at least 4.5 to 1."""
    grounds = (colours.window, colours.base)
    for text in (colours.text, colours.dim, colours.good, colours.bad):
        for ground in grounds:
            assert contrast(text, ground) >= 4.5, (text, ground)
    assert contrast(colours.on_simulated, colours.simulated) >= 4.5
    assert contrast("#ffffff", colours.stop) >= 4.5
    assert contrast(colours.on_accent, colours.accent) >= 4.5
    # WCAG 2.2, 1.4.11: graphical objects, at least 3 to 1.
    for mark in (colours.points, colours.blocked, colours.beam):
        assert contrast(mark, colours.base) >= 3.0


@pytest.mark.parametrize("palette", [PAPER, LIGHT, DARK, DISC], ids=["paper", "light", "dark", "disc"])
def test_marks_and_colours_of_values_have_a_contrast_of_3_to_1_to_their_ground(palette: Palette) -> None:
    """WCAG 2.2, 1.4.11, on paper and in both schemes; colours of values are on the disc, which has one ground in all."""
    for mark in (palette.points, palette.blocked, palette.predicted, palette.bad):
        assert contrast(mark, palette.base) >= 3.0
    own = [getattr(palette, MARKS[kind].colour, MARKS[kind].colour) for kind in ("light", "specular") if palette is DISC]
    colours: list[ColourMap] = ["values", "deviations"] if palette is DISC else []
    for each in colours:
        own += [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in colour_table(each).tolist()]
    assert all(contrast(each, palette.base) >= 3.0 for each in own)


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
def test_durations_are_rounded_to_two_units(seconds: float, text: str) -> None:
    assert rounded_duration_text(seconds) == text
