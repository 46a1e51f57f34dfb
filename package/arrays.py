"""Type names of arrays, and arrays that cannot be written, for the whole package; numpy alone is below."""

from typing import Any

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


def read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The same numbers, which cannot be written, and will not be: neither can `array` and what it is a view of."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner.flags.writeable = False
        owner = owner.base
    return view


class ReadOnlyArrays:
    """Base of frozen dataclasses whose arrays cannot be written, nor those of a copy or after unpickling."""

    def __post_init__(self) -> None:
        """Put views that cannot be written in the place of the arrays."""
        for name, held in vars(self).items():
            if isinstance(held, np.ndarray):
                object.__setattr__(self, name, read_only(held))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over what a copy has; numpy does not keep that an array cannot be written."""
        vars(self).update(state)
        ReadOnlyArrays.__post_init__(self)
