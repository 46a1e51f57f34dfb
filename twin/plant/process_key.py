"""Keys of random processes, the first argument of `twin.plant.noise`."""

from hashlib import blake2b

import numpy as np


def process_key(seed: int, process: str) -> np.uint64:
    """Key of a named process under a seed."""
    return np.uint64(int.from_bytes(blake2b(f"{seed}/{process}".encode(), digest_size=8).digest(), "big"))
