"""A row: what is done between two commits."""

from dataclasses import dataclass
from typing import Literal

RowKind = Literal["mount", "dark", "measure", "drift", "warm-up"]
NO_SAMPLE = "nothing"
"""The name of no sample: what a row says that is done with the sample unit empty."""
MIRRORED_MARK = "/mirrored"
"""What the identity of a row has in it that only checks the stated symmetry. No name has a slash in it."""
SKIPPED = "skipped"
"""The flag of a row that was left out for a fault."""
RESUME_PREFIX = "resumed "
"""What the identity of a row begins with that nobody has planned: a campaign that is gone on with begins with such rows."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row.

    `pose` has the angles of gamma, sigma, beta, shift in degrees. `gains` are numbers in the rig's list: it is read at each of
    them, or, where gains are `automatic`, at those of them that some photodiode needs. `readings` are taken at each; with a
    `target`, a relative standard uncertainty, more of them until that is reached, or `longest_s` have passed.

    A `drift` row is a measurement that only says whether the light is still what it was; a `warm-up` row waits with open
    shutter until the monitor is steady to `target` in ten minutes, `longest_s` at most.
    """

    number: int
    identity: str
    kind: RowKind
    sample: str
    seconds: float = 0.0
    wavelength_nm: float | None = None
    pose: tuple[float, float, float, float] | None = None
    gains: tuple[int, ...] = ()
    readings: int = 0
    automatic: bool = False
    target: float | None = None
    longest_s: float = 0.0

    @property
    def mirrored(self) -> bool:
        """Whether it is there to check the symmetry: a mirror image of another row."""
        return MIRRORED_MARK in self.identity

    @property
    def added(self) -> bool:
        """Whether it belongs to the beginning of a resumed session, and not to the plan."""
        return self.identity.startswith(RESUME_PREFIX)
