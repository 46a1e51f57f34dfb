"""Shadow maps of the mirror unit as CSV and as a picture."""

import csv
from pathlib import Path

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.shadow import shadow_maps, write_shadows
from goniotwin.twin.optics import Instrument


def test_the_csv_has_every_direction_of_both_arcs_and_is_marked_as_simulated(tmp_path: Path) -> None:
    path = tmp_path / "shadow.csv"
    write_shadows(shadow_maps(Instrument(), [0.0, 30.0], 15.0), path)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# SIMULATED")
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert len(rows) == 2 * 2 * 7 * 25
    (normal,) = (row for row in rows if row == {**row, "sigma_deg": "0", "arc": "upper", "polar_deg": "0", "azimuth_deg": "0"})
    assert float(normal["visible"]) == 0.0


def test_the_file_states_that_obstruction_is_switched_off(tmp_path: Path) -> None:
    path = tmp_path / "shadow.csv"
    write_shadows(shadow_maps(Instrument(obstruction=False), [0.0], 30.0), path)
    assert "switched off" in path.read_text(encoding="utf-8")


def test_the_picture_is_a_png(tmp_path: Path) -> None:
    write_shadows(shadow_maps(Instrument(), [0.0], 10.0), tmp_path / "shadow.png")
    assert (tmp_path / "shadow.png").read_bytes().startswith(b"\x89PNG")


def test_invalid_names_and_steps_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"\.csv or \.png"):
        write_shadows(shadow_maps(Instrument(), [0.0], 30.0), tmp_path / "shadow.txt")
    with pytest.raises(UserError, match=r"cannot be written|no folder"):
        write_shadows(shadow_maps(Instrument(), [0.0], 30.0), tmp_path / "nowhere" / "shadow.png")
    with pytest.raises(UserError, match="step"):
        shadow_maps(Instrument(), [0.0], 0.7)
