"""Detectors that are computed together: one buffer with a row for each number of a detector.

All rows have the same length, a constant of the compiled code, so LLVM knows that they do not overlap and makes vectors of
every loop over the detectors.
"""

BLOCK = 64
# Where a row begins in the buffer: the detector's place (mm) and view, away from the sample.
PX, PY, PZ, DX, DY, DZ = (row * BLOCK for row in range(6))
# Its frame, e1 away from the normal and e2 level, and its place along e1, e2 and the view.
E1X, E1Y, E1Z, E2X, E2Y, BESIDE1, BESIDE2, AHEAD = (row * BLOCK for row in range(6, 14))
# The moments of what its aperture takes: place in the hole (u, v), mm, and slopes to its axis (p, q).
MOMENTS = 15
M, MU, MV, MP, MQ, MUU, MUV, MVV, MUP, MUQ, MVP, MVQ, MPP, MPQ, MQQ = (row * BLOCK for row in range(14, 29))
# Of one slope: how the hole is seen on the disc, and the stripe of it that the disc holds; and the sums over that.
A0, AU, AV, B0, BU, BV, MIDDLE, HALF, INVERSE, SHARE = (row * BLOCK for row in range(29, 39))
S, SU, SV, SUU, SUV, SVV = (row * BLOCK for row in range(39, 45))
# Of the rays that stand for it: means, how each number goes with the offsets along and across, their covariance's root.
U0, V0, P0, Q0, GU1, GU2, GV1, GV2, GP1, GP2, GQ1, GQ2 = (row * BLOCK for row in range(29, 41))
GA1, GA2, GB1, GB2, T11, T21, T22, RADIUS = (row * BLOCK for row in range(41, 49))
# One ray: weight, the light's direction, the observer's.
RAY = 49 * BLOCK
WEIGHT, LX, LY, LZ, WX, WY, WZ = (row * BLOCK for row in range(49, 56))
ROWS = 56
