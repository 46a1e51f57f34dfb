"""Elementary functions in single precision, without calls or branches, so that LLVM vectorises loops over them.

Minimax polynomials; the stated errors are those before rounding.
"""

import numpy as np

from goniotwin.twin.optics.kernel import kernel

F32 = np.float32
I32 = np.int32
PI = np.float32(np.pi)
ONE, TWO, HALF = np.float32(1.0), np.float32(2.0), np.float32(0.5)
LN2, LOG2_E = np.float32(np.log(2.0)), np.float32(1.0 / np.log(2.0))
S1, S2, S3 = np.float32(-0.1666666662), np.float32(0.008333330981), np.float32(-0.0001984086193)
S4, S5 = np.float32(2.752530443e-06), np.float32(-2.38897788e-08)
C1, C2, C3 = np.float32(-0.4999999936), np.float32(0.04166663626), np.float32(-0.00138883614)
C4, C5 = np.float32(2.476016136e-05), np.float32(-2.605149531e-07)
A1, A2, A3 = np.float32(0.1666679222), np.float32(0.07494367504), np.float32(0.04555769254)
A4, A5 = np.float32(0.02382393855), np.float32(0.04269030159)
E0, E1, E2, E3 = np.float32(1.000000072), np.float32(0.6931469671), np.float32(0.2402211972), np.float32(0.05550713274)
E4, E5 = np.float32(0.009675541333), np.float32(0.001327647178)
T1, T2, T3 = np.float32(0.3333340826), np.float32(0.1998737021), np.float32(0.1496347914)
# Bits of the square root of 0.5, width of the mantissa, exponent's bias, and the least exponent.
ROOT_HALF_BITS, MANTISSA_BITS, BIAS, LEAST = np.int32(0x3F3504F3), np.int32(23), np.int32(127), np.float32(-80.0)


@kernel(inline="always")
def sine_ratio(square: np.float32) -> np.float32:
    """sin(x) / x for the square of x, up to (pi / 2)^2, to 2e-11."""
    return F32(ONE + square * (S1 + square * (S2 + square * (S3 + square * (S4 + square * S5)))))


@kernel(inline="always")
def cosine(square: np.float32) -> np.float32:
    """cos(x) for the square of x, up to (pi / 2)^2, to 2e-10."""
    return F32(ONE + square * (C1 + square * (C2 + square * (C3 + square * (C4 + square * C5)))))


@kernel(inline="always")
def cosine_and_sine(share: np.float32) -> tuple[np.float32, np.float32]:
    """Cosine and sine of a share of the whole turn, 0 to 1, counted from the negative x axis."""
    half = PI * (share - HALF)
    square = half * half
    sin, cos = half * sine_ratio(square), cosine(square)
    return F32(cos * cos - sin * sin), F32(TWO * sin * cos)


@kernel(inline="always")
def minus_log(x: np.float32) -> np.float32:
    """-ln(x) for a normal x above 0, to 1e-9 of it."""
    bits = F32(x).view(np.int32)
    exponent = I32(I32(bits - ROOT_HALF_BITS) >> MANTISSA_BITS)
    above = F32(I32(bits - I32(exponent << MANTISSA_BITS)).view(np.float32) - ONE)
    s = above / (TWO + above)
    square = s * s
    return F32(-F32(exponent) * LN2 - TWO * s * (ONE + square * (T1 + square * (T2 + square * T3))))


@kernel(inline="always")
def exp_minus(x: np.float32) -> np.float32:
    """exp(-x) for x >= 0, to 8e-8 of it; 0 below 2^-80: operations with denormal numbers are a hundred times as slow."""
    exact = F32(-x * LOG2_E)
    y = max(exact, LEAST)
    whole = I32(y - HALF)
    rest = F32(y - F32(whole))
    power = I32(I32(whole + BIAS) << MANTISSA_BITS).view(np.float32)
    value = F32(power * (E0 + rest * (E1 + rest * (E2 + rest * (E3 + rest * (E4 + rest * E5))))))
    return value if exact > LEAST else F32(0.0)


@kernel(inline="always")
def arcsine(x: np.float32) -> np.float32:
    """asin(x) for x within 0 and 1, to 1e-8."""
    steep = x > HALF
    rest = F32(np.sqrt(HALF * (ONE - min(x, ONE)))) if steep else F32(x)
    square = rest * rest
    small = F32(rest * (ONE + square * (A1 + square * (A2 + square * (A3 + square * (A4 + square * A5))))))
    return F32(HALF * PI - TWO * small) if steep else small
