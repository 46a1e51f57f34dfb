"""Kernels of the search for a short path.

A path is an array (n + 2,) of the points' numbers with the number n, which is not a point, at both ends. The kernels assign no
arrays to slices: numba compiles the text of an error message for that, which takes longer than the kernels.
"""

from typing import Any

import numpy as np

from goniotwin.twin.optics.kernel import kernel

TINY_S = 1e-7
"""Least saving of a change."""


@kernel(error_model="python")
def shorten(path: Any, table: Any, lengths: Any, reach: int, work: int) -> None:
    """Shorten a path by a `table` of costs: reverse pieces, and move those of `lengths`, `reach` far, within `work` steps."""
    n = len(path) - 2
    forth, back = np.zeros(n + 2), np.zeros(n + 2)
    _sums(path, table, forth, back)
    better = True
    while better:
        better = False
        for i in range(1, n):
            far = min(n + 1, i + 1 + reach)
            work -= 4 * (far - i)
            if _reverse_piece(path, table, forth, back, i, far):
                work -= 2 * n
                better = True
            if work <= 0:
                return
        for size in lengths:
            if 2 * size > n:
                break
            for i in range(1, n - size + 2):
                near, far = max(1, i - reach), min(n + 1, i + size + reach)
                work -= 5 * (far - near - size)
                if _move_piece(path, table, forth, back, i, size, near, far):
                    work -= 2 * n
                    better = True
                if work <= 0:
                    return


@kernel(error_model="python")
def _sums(path: Any, table: Any, forth: Any, back: Any) -> None:
    """Seconds from the start of the path to each place, and back."""
    for k in range(1, len(path)):
        forth[k] = forth[k - 1] + table[path[k - 1], path[k]]
        back[k] = back[k - 1] + table[path[k], path[k - 1]]


@kernel(error_model="python")
def _reverse_piece(path: Any, table: Any, forth: Any, back: Any, i: int, far: int) -> bool:
    """Reverse the path from place `i` to the best place before `far`, if this saves time; whether it did."""
    before, first = path[i - 1], path[i]
    best, chosen = -TINY_S, -1
    for j in range(i + 1, far):
        last, after = path[j], path[j + 1]
        present = table[before, first] + table[last, after] + forth[j] - forth[i]
        reversed_s = table[before, last] + table[first, after] + back[j] - back[i]
        if reversed_s - present < best:
            best, chosen = reversed_s - present, j
    if chosen < 0:
        return False
    for k in range((chosen + 1 - i) // 2):
        path[i + k], path[chosen - k] = path[chosen - k], path[i + k]
    _sums(path, table, forth, back)
    return True


@kernel(error_model="python")
def _move_piece(path: Any, table: Any, forth: Any, back: Any, i: int, size: int, near: int, far: int) -> bool:
    """Move the piece of this size at place `i` before the best place from `near` to `far`, in either direction, if this saves
    time; whether it did.
    """
    end = i + size
    before, first, last, after = path[i - 1], path[i], path[end - 1], path[end]
    gain = table[before, first] + table[last, after] - table[before, after]
    reversal_s = back[end - 1] - back[i] - forth[end - 1] + forth[i]
    best, chosen, reverse = -TINY_S, -1, False
    for place in range(near, far + 1):
        if i <= place <= end:
            continue
        left, right = path[place - 1], path[place]
        apart = table[left, right] + gain
        forward_s = table[left, first] + table[last, right] - apart
        backward_s = table[left, last] + table[first, right] + reversal_s - apart
        if forward_s < best:
            best, chosen, reverse = forward_s, place, False
        if backward_s < best:
            best, chosen, reverse = backward_s, place, True
    if chosen < 0:
        return False
    piece = path[i:end].copy()
    if chosen < i:
        start = chosen
        for k in range(i - 1, chosen - 1, -1):
            path[k + size] = path[k]
    else:
        start = chosen - size
        for k in range(end, chosen):
            path[k - size] = path[k]
    for k in range(size):
        path[start + k] = piece[size - 1 - k] if reverse else piece[k]
    _sums(path, table, forth, back)
    return True
