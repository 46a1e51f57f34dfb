"""Counter-based random numbers: each is a function of a key and of which number it is, and of nothing that came before.

So a path's numbers do not depend on the thread that traces it. 64-bit ones for scalar code, 32-bit ones for loops over
a block of paths, which LLVM makes vectors of.
"""

import numpy as np

from goniotwin.twin.optics.kernel import kernel

U32 = np.uint32
U64 = np.uint64
F32 = np.float32
HALF_16 = np.float32(2.0**-17)
STEP_16 = np.float32(2.0**-16)
STEP_24 = np.float32(2.0**-24)


@kernel()
def scrambled(bits: np.uint64) -> np.uint64:
    """64 bits that look random: the finaliser of splitmix64 (Steele, Lea, Flood 2014)."""
    # Every constant is cast: with a plain integer numba goes over to floats, and the bits are wrong without a word.
    bits = (bits ^ (bits >> U64(30))) * U64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> U64(27))) * U64(0x94D049BB133111EB)
    return bits ^ (bits >> U64(31))


@kernel()
def uniform(key: np.uint64, counter: int) -> float:
    """Number `counter` of a path's key, in [0, 1)."""
    bits = scrambled(key + U64(counter + 1) * U64(0x9E3779B97F4A7C15))
    return float(bits >> U64(11)) * 1.1102230246251565e-16


@kernel()
def word_key(key: np.uint64, counter: int) -> np.uint32:
    """Key of a block's 32-bit words number `counter`: see `word`."""
    return U32(scrambled(key + U64(counter + 1) * U64(0x9E3779B97F4A7C15)) >> U64(32))


@kernel(inline="always")
def word(key: np.uint32, i: int) -> np.uint32:
    """32 bits of path i of a block, for one of its keys: a mixer of two multiplications (Wellons 2018, "lowbias32").

    The paths' numbers are spread by the golden section first: of numbers in a row the mixer makes neighbours that know of each
    other (chi-square 4 standard deviations off among a million). For i below 2^32 no word comes twice. Blocks have independent
    keys for each of a path's words, so that two paths whose words are all alike are as rare as among random ones.
    """
    bits = U32(U32(U32(i) * U32(0x9E3779B9)) + key)
    # numba takes 32 bits for 64 after every operation: they are cast back each time.
    bits = U32(bits ^ U32(bits >> U32(16)))
    bits = U32(bits * U32(0x7FEB352D))
    bits = U32(bits ^ U32(bits >> U32(15)))
    bits = U32(bits * U32(0x846CA68B))
    return U32(bits ^ U32(bits >> U32(16)))


@kernel(inline="always")
def low_16(bits: np.uint32) -> np.float32:
    """A number within 0 and 1 from the lower half of a word: the middle of one of 65536 intervals."""
    return F32(F32(np.int32(bits & U32(0xFFFF))) * STEP_16 + HALF_16)


@kernel(inline="always")
def high_16(bits: np.uint32) -> np.float32:
    """The same from the upper half."""
    return F32(F32(np.int32(bits >> U32(16))) * STEP_16 + HALF_16)


@kernel(inline="always")
def upper_24(bits: np.uint32) -> np.float32:
    """A number in [0, 1), exact in single precision, from the upper 24 bits of a word."""
    return F32(F32(np.int32(bits >> U32(8))) * STEP_24)
