"""Type names of arrays, for the whole package; numpy alone is below."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]
Counts = npt.NDArray[np.uint16]
"""Raw counts of a converter."""
