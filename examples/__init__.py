"""Example rigs and schedules, which travel with the program: the demonstration and the window start with them."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent
RIG = FOLDER / "rigs" / "virtual.toml"
SCHEDULE = FOLDER / "schedules" / "quick.toml"
FIRST_RIG, FIRST_SCHEDULE = FOLDER / "rigs" / "first.toml", FOLDER / "schedules" / "first.toml"
"""With these the window opens where no files are named."""
