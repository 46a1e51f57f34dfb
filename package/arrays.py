"""Type names of arrays, for the whole package; numpy alone is below."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]
Texts = npt.NDArray[np.str_]
Counts = npt.NDArray[np.uint16]
"""Raw counts of a converter."""
Singles = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int32]
Words = npt.NDArray[np.uint32]
"""32-bit words: random numbers' keys, and indices without a sign."""
Bytes = npt.NDArray[np.uint8]
Keys = npt.NDArray[np.uint64]
"""Keys of 64-bit random numbers."""
