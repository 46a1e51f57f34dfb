"""A row: what is done between two commits."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["mount", "dark", "measure"]


@dataclass(frozen=True, slots=True)
class Row:
    """One row. `pose` has the angles of gamma, sigma, beta, shift in degrees; `gains` are numbers in the rig's list."""

    number: int
    identity: str
    kind: Kind
    sample: str
    seconds: float = 0.0
    wavelength_nm: float | None = None
    pose: tuple[float, float, float, float] | None = None
    gains: tuple[int, ...] = ()
    readings: int = 0
