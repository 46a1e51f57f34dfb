"""The results screen: a campaign or a file is opened beside the window, a light chosen, the value at the cursor read."""

import itertools
import multiprocessing
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QTextBrowser
from pytestqt.qtbot import QtBot

import goniotwin
from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.reduction.components import kinds
from goniotwin.app.campaign.rehearsal.without_wires import rows_without_wires, run_without_wires
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.results import Light, Results, View, first_light, nearest_light
from goniotwin.app.desktop.campaigns.screen import CampaignsScreen
from goniotwin.app.desktop.dialogs import TextBox
from goniotwin.app.desktop.model.results import half_and_difference, value_texts
from goniotwin.app.desktop.model.worker import ENDED
from goniotwin.app.desktop.results.screen import COMPARISONS, NOTHING, PICTURES, ResultsScreen
from goniotwin.app.desktop.theme import DARK, LIGHT
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import COVERAGE
from goniotwin.app.rig import read_rig
from tests.app.desktop.conftest import READY_MS, WindowOpener, click, ready
from tests.app.desktop.keyboard import focused, press, tab_to
from tests.conftest import RIG, SMALL, Writer

TWO = SMALL.replace("sigma_deg = [30]", "sigma_deg = [30, 45]").replace("[550]", "[500, 550, 600]")


@pytest.fixture
def plan(write_schedule: Writer) -> NewPlan:
    return make_plan(read_schedule(write_schedule(text=TWO)), read_rig(RIG))


@pytest.fixture
def journal(plan: NewPlan, journals: Path) -> Path:
    journals.mkdir()
    run_without_wires(plan, journals / "two.journal")
    return journals / "two.journal"


@pytest.fixture
def screen(qtbot: QtBot) -> ResultsScreen:
    """The screen alone, with its worker."""
    screen = ResultsScreen(LIGHT)
    qtbot.addWidget(screen, before_close_func=lambda _: screen.shut_down())
    screen.complete()
    screen.resize(1100, 560)
    screen.show()
    return screen


def opened(qtbot: QtBot, screen: ResultsScreen, path: Path) -> None:
    screen.open_file(path)
    assert screen.heading.text() == f"Reading {path.name} …"
    qtbot.waitUntil(lambda: screen.shown is not None or screen.heading.text().startswith("✗"), timeout=READY_MS)
    assert screen.shown is not None, screen.heading.text()


def choose(qtbot: QtBot, screen: ResultsScreen, field: str, text: str) -> None:
    """Choose a value as a person does, and wait for its picture."""
    choice, before = screen.choices[field], screen.shown
    choice.setFocus()
    at = choice.findText(text)
    for _ in range(abs(at - choice.currentIndex())):
        qtbot.keyClick(choice, Qt.Key.Key_Down if at > choice.currentIndex() else Qt.Key.Key_Up)
    qtbot.waitUntil(lambda: screen.shown is not before and screen.shown is not None, timeout=READY_MS)
    settled(qtbot, screen)


def settled(qtbot: QtBot, screen: ResultsScreen) -> None:
    """Wait for what was chosen last."""
    qtbot.waitUntil(lambda: screen.shown is not None and screen.shown.view == screen.wanted, timeout=READY_MS)


def agrees(screen: ResultsScreen, of: Dataset) -> None:
    """What is shown is what `goniotwin.open` gives of this light."""
    assert screen.shown is not None
    for name in ("bsdf", "u", "theta_deg", "phi_deg", "polar_deg", "azimuth_deg", "flags", "photodiode"):
        np.testing.assert_array_equal(screen.shown.data.column(name), getattr(of, name))
    value, where, shares = (each.text().replace("\u00a0", " ") for each in screen.texts)
    k = screen.index
    assert value.startswith(f"{of.bsdf[k]:.4g} ± {COVERAGE * of.u[k]:.2g} 1/sr (k = 2)")
    assert f"polar angle {of.polar_deg[k]:.2f}°, azimuth {of.azimuth_deg[k]:.2f}°; θ {of.theta_deg[k]:.2f}°" in where
    if of.origin != "journal":
        assert shares == ""
        return
    names = sorted(of.components, key=lambda each: -of.components[each][k])[:5]
    for name in names:
        share = (of.components[name][k] / of.u[k]) ** 2
        assert (f"{kinds()[name].words} {100.0 * share:.0f} %" in shares) == (share >= 0.005)


def test_a_campaign_is_opened_by_enter_and_its_values_are_read_by_keys(
    qtbot: QtBot, open_window: WindowOpener, journal: Path
) -> None:
    window = ready(qtbot, open_window())
    window.resize(1280, 800)
    campaigns, screen = window.view.screen_of(CampaignsScreen), window.view.screen_of(ResultsScreen)
    assert screen.heading.text() == NOTHING
    press("Ctrl+5")
    qtbot.waitUntil(lambda: campaigns.results_button.isEnabled(), timeout=READY_MS)
    tab_to("Campaigns")
    press("Return")
    assert window.view.screens[window.view.shown_screen] is screen
    qtbot.waitUntil(lambda: screen.shown is not None, timeout=READY_MS)
    assert screen.heading.text().startswith("small: journal, ")
    assert screen._mark.isVisible()
    dataset = goniotwin.open(journal)
    assert screen.only.text() == "gaussian-5, front, reflected, ψ 0°"
    assert not screen.choices["sample"].isVisible()
    agrees(screen, dataset.select(wavelength_nm=550.0, sigma_deg=30.0))
    assert screen.index == int(np.argmax(dataset.select(wavelength_nm=550.0, sigma_deg=30.0).bsdf))
    choose(qtbot, screen, "colour", "600 nm")
    choose(qtbot, screen, "sigma_deg", "σ 45°")
    of = dataset.select(wavelength_nm=600.0, sigma_deg=45.0)
    agrees(screen, of)
    tab_to("Picture beside the hemisphere")
    first, angles = screen.index, []
    for key in ("Left", "Left", "Right"):
        press(key)
        agrees(screen, of)
        angles.append(of.polar_deg[screen.index])
    assert angles[0] == angles[2]
    assert of.polar_deg[first] > angles[0] > angles[1]
    press("Shift+Tab")
    assert focused() == "Hemisphere of the results"
    press("Right")
    assert of.polar_deg[screen.index] == of.polar_deg[first]
    before = screen.index
    press("Up")  # all values are in the plane
    assert screen.index == before
    click(screen.again_button)
    qtbot.waitUntil(lambda: screen.shown is not None, timeout=READY_MS)
    agrees(screen, of)
    press("Ctrl+5")
    click(campaigns.results_button)
    assert window.view.screens[window.view.shown_screen] is screen


def test_a_file_has_the_values_that_it_has_for_open(qtbot: QtBot, screen: ResultsScreen, journal: Path, tmp_path: Path) -> None:
    goniotwin.open(journal).save(tmp_path / "a.csv")
    opened(qtbot, screen, tmp_path / "a.csv")
    dataset = goniotwin.open(tmp_path / "a.csv")
    agrees(screen, dataset.select(wavelength_nm=550.0, sigma_deg=30.0))
    choose(qtbot, screen, "sigma_deg", "σ 45°")
    agrees(screen, dataset.select(wavelength_nm=550.0, sigma_deg=45.0))
    screen.set_colours(DARK)
    screen.grab()
    assert screen.pictures is not None
    disc, cut, _ = screen.pictures
    assert "highest" in disc.summary
    assert cut.summary.startswith("bands: U (k = 2), median")


def test_a_damaged_file_has_one_line_and_the_next_one_is_opened(
    qtbot: QtBot, screen: ResultsScreen, journal: Path, tmp_path: Path
) -> None:
    damaged = tmp_path / "damaged.journal"
    content = bytearray(journal.read_bytes())
    content[2000:] = bytes(len(content) - 2000)
    damaged.write_bytes(content)
    for path in (damaged, tmp_path / "none.csv"):
        screen.open_file(path)
        qtbot.waitUntil(lambda: screen.heading.text().startswith("✗ "), timeout=READY_MS)
        assert path.name in screen.heading.text()
        assert "\n" not in screen.heading.text()
        assert screen.shown is None
        assert not screen.plots.isVisible()
        with pytest.raises(UserError) as raised:
            goniotwin.open(path)
        assert screen.heading.text() == f"✗ {raised.value}"
    opened(qtbot, screen, journal)
    assert screen.plots.isVisible()
    assert screen.heading.text().startswith("small: journal")


@pytest.mark.long
def test_a_campaign_in_progress_is_opened_and_read_again(
    qtbot: QtBot, screen: ResultsScreen, plan: NewPlan, tmp_path: Path
) -> None:
    model = plan.rig.model()
    assert model is not None
    rows = rows_without_wires(plan, model)
    path = tmp_path / "running.journal"
    with Journal.create(path, plan, software_versions()) as journal:
        journal.begin_session(0.0, plan.rig.text, software_versions())
        screen.open_file(path)
        qtbot.waitUntil(lambda: screen.heading.text().startswith("✗ "), timeout=READY_MS)
        for each in itertools.islice(rows, len(plan.rows) - 4):
            journal.commit(each.row, each.data)
        click(screen.again_button)
        qtbot.waitUntil(lambda: screen.shown is not None, timeout=READY_MS)
        some = goniotwin.open(path)
        before = screen.heading.text()
        assert f"{some.size} values" in before
        for each in rows:
            journal.commit(each.row, each.data)
        click(screen.again_button)
        qtbot.waitUntil(lambda: screen.shown is not None, timeout=READY_MS)
    assert goniotwin.open(path).size > some.size
    assert screen.heading.text() != before


@pytest.mark.long
def test_a_worker_that_is_ended_is_reported_and_the_next_file_has_another(
    qtbot: QtBot, screen: ResultsScreen, journal: Path
) -> None:
    opened(qtbot, screen, journal)
    (worker,) = [each for each in multiprocessing.active_children() if each.name == "results"]
    worker.kill()
    qtbot.waitUntil(lambda: screen.heading.text() == f"✗ {ENDED}", timeout=READY_MS)
    opened(qtbot, screen, journal)


def test_pictures_a_comparison_and_the_checks_are_chosen_by_keys(
    qtbot: QtBot, screen: ResultsScreen, journal: Path, tmp_path: Path
) -> None:
    opened(qtbot, screen, journal)
    qtbot.waitUntil(lambda: screen.checked is not None, timeout=READY_MS)
    assert screen.checked is not None
    assert screen.heading.text().endswith(screen.checked.summary)
    assert screen.pictures is not None
    _, plot, lobe = screen.pictures
    for picture in list(PICTURES)[1:]:
        screen.picture.setFocus()
        qtbot.keyClick(screen.picture, Qt.Key.Key_Down)
        settled(qtbot, screen)
        assert screen.shown is not None
        assert screen.shown.view.picture == picture
        screen.grab()
        if picture == "spectrum" and screen.shown.beside is not None:
            (low, high), _ = plot.keys.view.getPlotItem().vb.viewRange()
            assert min(screen.shown.beside.series[0].x) - 20.0 < low < high < max(screen.shown.beside.series[0].x) + 20.0
    assert lobe.isVisible()
    assert lobe.accessibleDescription().startswith("The directions span no area")  # all are in the plane of incidence
    screen.picture.setCurrentIndex(0)
    screen.picture.activated.emit(0)
    screen.comparison.setFocus()
    qtbot.keyClick(screen.comparison, Qt.Key.Key_Down)
    settled(qtbot, screen)
    assert screen.comparison.currentText() == COMPARISONS[1]
    assert screen.shown is not None
    assert screen.shown.compared is not None
    assert "chi-square" in plot.summary
    second, _, z = screen.shown.compared[:, screen.index]
    assert f"; second {second:.4g} 1/sr, z = {z:+.2f}; " in screen.texts[0].text()
    click(screen.check_button)
    (box,) = [each for each in screen.findChildren(TextBox) if each.isVisible()]
    (shown,) = box.findChildren(QTextBrowser)
    assert "energy of gaussian-5: " in shown.toPlainText()
    box.close()


def test_a_choice_takes_the_nearest_light_that_there_is(tmp_path: Path) -> None:
    lights = (
        Light("a", "450 nm", "front", "reflected", 0.0, 0.0),
        Light("a", "550 nm", "front", "reflected", 30.0, 0.0),
        Light("a", "550 nm", "front", "reflected", 60.0, 90.0),
        Light("a", "650 nm", "front", "transmitted", 0.0, 0.0),
        Light("b", "550 nm", "front", "reflected", 45.0, 0.0),
    )
    assert first_light(lights) == lights[1]
    assert nearest_light(lights, lights[1], "direction", "transmitted") == lights[3]
    assert nearest_light(lights, lights[1], "psi_deg", 90.0) == lights[2]
    assert nearest_light(lights, lights[2], "sample", "b") == lights[4]
    assert nearest_light(lights, lights[3], "sample", "c") == lights[3]  # a file that is read again and has it no longer


def test_half_and_difference_angle() -> None:
    assert half_and_difference(30.0, 30.0, 180.0) == pytest.approx((0.0, 30.0), abs=1e-9)
    assert half_and_difference(30.0, 30.0, 0.0) == pytest.approx((30.0, 0.0), abs=1e-9)
    assert half_and_difference(0.0, 60.0, 77.0) == pytest.approx((30.0, 30.0))


def test_channels_sides_and_values_without_uncertainty_or_trust(tmp_path: Path) -> None:
    polar = np.tile([0.0, 20.0, 40.0], 4)
    table = {
        "sigma_deg": np.full(12, 20.0),
        "polar_deg": polar,
        "azimuth_deg": np.full(12, 180.0),
        "bsdf": np.linspace(0.1, 0.3, 12),
        "channel": np.repeat(["red", "green"], 6),
        "transmitted": np.tile(np.repeat([False, True], 3), 2),
        "flags": np.array(["", "", "clipped"] * 3 + ["clipped"] * 3),
    }
    results = Results(Dataset.from_table(table))
    lights = results.lights
    assert {(each.colour, each.direction) for each in lights} == set(
        itertools.product(("red", "green"), ("reflected", "transmitted"))
    )
    light = next(each for each in lights if each[1:4] == ("red", "front", "reflected"))
    shown = results.show(View(light))
    value, where, shares = value_texts(shown, 2)
    assert value == "0.1364 1/sr, no uncertainty; clipped: saturated at every gain"
    assert "row" not in where
    assert shares == ""
    assert shown.highest == 1
    assert shown.beside is not None
    assert shown.beside.scale is not None
    with pytest.raises(UserError, match="no value of this light is to be trusted"):
        results.show(View(next(each for each in lights if each[1:4] == ("green", "front", "transmitted"))))
    aside = Results(Dataset.from_table({name: each[:3] for name, each in table.items()} | {"azimuth_deg": np.full(3, 90.0)}))
    (light,) = aside.lights
    shown = aside.show(View(light))
    assert shown.plane.size == 1  # the normal
