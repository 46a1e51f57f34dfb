"""Example rigs and schedules, which travel with the program: the demonstration and the window start from them."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent
RIG = FOLDER / "rigs" / "virtual.toml"
SCHEDULE = FOLDER / "schedules" / "quick.toml"
