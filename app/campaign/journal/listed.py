"""Which rows of a journal were measured, and where: a few bytes a row, however many there are."""

import sqlite3

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.row import MIRRORED

LISTED = np.dtype(
    [
        ("number", np.int64),
        ("sample", np.int32),
        ("mirrored", np.bool_),
        ("wavelength_nm", np.float64),
        ("gamma_deg", np.float64),
        ("sigma_deg", np.float64),
        ("beta_deg", np.float64),
        ("shift_deg", np.float64),
    ]
)
"""One row; `sample` is the place of its name in a list that stands beside."""


def measured_rows(db: sqlite3.Connection) -> tuple[npt.NDArray[np.void], list[str]]:
    """Committed rows of measurements that have readings, by their last attempt, in order of time; and the samples' names.

    Raises sqlite3.Error and ValueError for a damaged journal.
    """
    names: dict[str, int] = {}
    found = db.execute(
        "SELECT p.number, sample, instr(identity, ?) > 0, wavelength_nm, gamma_deg, sigma_deg, beta_deg, shift_deg"
        " FROM plan p JOIN attempt a USING (number) WHERE kind = 'measure'"
        " AND attempt = (SELECT MAX(attempt) FROM attempt b WHERE b.number = p.number)"
        " AND EXISTS (SELECT 1 FROM reading r WHERE r.number = p.number AND r.attempt = a.attempt)"
        " ORDER BY started_s, p.number",
        (MIRRORED,),
    )
    rows = ((number, names.setdefault(sample, len(names)), *rest) for number, sample, *rest in found)
    return np.fromiter(rows, dtype=LISTED), list(names)
