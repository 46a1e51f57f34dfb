"""Kernels that shorten a path: pieces are turned round, or taken out and put back where they cost less.

A path is an array (n + 2,) of points' numbers with the number n, which is no point, at both ends; `table` (n + 1, n + 1) says
what each step costs, and what it costs to begin or to end at a point. What is done is cheaper by more than TINY_S each time.
"""

from typing import Any

import numpy as np

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.kernel import kernel

TINY_S = 1e-7
PIECES = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])
"""How many points are moved together."""
LEAST_REACH = 8


def shortened(path: Ints, table: Floats, work: int) -> Ints:
    """An order (n,) of which no piece costs less elsewhere or the other way round, or as far as `work` (steps) goes."""
    ended = np.concatenate([[len(path)], path, [len(path)]])
    reach = max(LEAST_REACH, work // (8 * len(path) * (len(PIECES) + 1)))
    _shorten(ended, table, PIECES, reach, work)
    return ended[1:-1]


@kernel(error_model="python")
def _shorten(path: Any, table: Any, pieces: Any, reach: int, work: int) -> None:
    n = len(path) - 2
    forth, back = np.zeros(n + 2), np.zeros(n + 2)
    _sums(path, table, forth, back)
    better = True
    while better:
        better = False
        for i in range(1, n):
            far = min(n + 1, i + 1 + reach)
            work -= 4 * (far - i)
            if _turned_round(path, table, forth, back, i, far):
                work -= 2 * n
                better = True
            if work <= 0:
                return
        for size in pieces:
            if 2 * size > n:
                break
            for i in range(1, n - size + 2):
                near, far = max(1, i - reach), min(n + 1, i + size + reach)
                work -= 5 * (far - near - size)
                if _put_elsewhere(path, table, forth, back, i, size, near, far):
                    work -= 2 * n
                    better = True
                if work <= 0:
                    return


@kernel(error_model="python")
def _sums(path: Any, table: Any, forth: Any, back: Any) -> None:
    """Seconds from the beginning to each place, and the way back."""
    for k in range(1, len(path)):
        forth[k] = forth[k - 1] + table[path[k - 1], path[k]]
        back[k] = back[k - 1] + table[path[k], path[k - 1]]


@kernel(error_model="python")
def _turned_round(path: Any, table: Any, forth: Any, back: Any, i: int, far: int) -> bool:
    """What is from place `i` to the best one before `far`, if that is a gain."""
    before, first = path[i - 1], path[i]
    best, where = -TINY_S, -1
    for j in range(i + 1, far):
        last, after = path[j], path[j + 1]
        was = table[before, first] + table[last, after] + forth[j] - forth[i]
        would = table[before, last] + table[first, after] + back[j] - back[i]
        if would - was < best:
            best, where = would - was, j
    if where < 0:
        return False
    path[i : where + 1] = path[i : where + 1][::-1].copy()
    _sums(path, table, forth, back)
    return True


@kernel(error_model="python")
def _put_elsewhere(path: Any, table: Any, forth: Any, back: Any, i: int, size: int, near: int, far: int) -> bool:
    """The piece of that size at place `i` before the best place from `near` to `far`, either way round, if that is a gain."""
    end = i + size
    before, first, last, after = path[i - 1], path[i], path[end - 1], path[end]
    gain = table[before, first] + table[last, after] - table[before, after]
    turned_s = back[end - 1] - back[i] - forth[end - 1] + forth[i]
    best, where, turned = -TINY_S, -1, False
    for place in range(near, far + 1):
        if i <= place <= end:
            continue
        left, right = path[place - 1], path[place]
        apart = table[left, right] + gain
        straight = table[left, first] + table[last, right] - apart
        other_way = table[left, last] + table[first, right] + turned_s - apart
        if straight < best:
            best, where, turned = straight, place, False
        if other_way < best:
            best, where, turned = other_way, place, True
    if where < 0:
        return False
    piece = path[i:end].copy()
    if turned:
        piece = piece[::-1].copy()
    if where < i:
        path[where + size : end] = path[where:i].copy()
        path[where : where + size] = piece
    else:
        path[i : where - size] = path[end:where].copy()
        path[where - size : where] = piece
    _sums(path, table, forth, back)
    return True
