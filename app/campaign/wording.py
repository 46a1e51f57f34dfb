"""Durations, positions, lists of numbers, values with their uncertainty, keys, and names from files as text."""

import math
from collections.abc import Iterable

ENCODER_LOST = "lost in the reset"
"""In place of an encoder's angle: its counter started again from zero, wherever the axis was."""


def duration_text(seconds: float) -> str:
    """A duration in hours, minutes and seconds, such as `2 h 05 min 30 s`; below one hour without the hours."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours} h {minutes:02d} min {whole % 60:02d} s" if hours else f"{minutes} min {whole % 60:02d} s"


def rounded_duration_text(seconds: float) -> str:
    """A duration with its two largest units: `4 s`, `2 min 05 s`, `3 h 07 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def place_text(counter_deg: float | None, encoder_deg: float | None, encoder_lost: bool = False) -> str:
    """Where counter and encoder of an axis are, and how far apart; None is unknown, or no encoder."""
    if counter_deg is None:
        return "position unknown"
    if encoder_lost:
        return f"counter {counter_deg:.3f} deg, encoder {ENCODER_LOST}"
    if encoder_deg is None:
        return f"counter {counter_deg:.3f} deg"
    apart = abs(encoder_deg - counter_deg)
    return f"counter {counter_deg:.3f} deg, encoder {encoder_deg:.3f} deg, {apart:.3f} deg apart"


def key_text(key: str) -> str:
    """A key as words with its unit: `arc_radius_mm` is `arc radius, mm`."""
    units = {"per_sr": "1/sr", "v_per_a": "V/A", "mm": "mm", "nm": "nm", "deg": "deg", "sr": "sr"}
    for unit, text in units.items():
        if key.endswith(f"_{unit}"):
            return f"{key.removesuffix(f'_{unit}').replace('_', ' ')}, {text}"
    return key.replace("_", " ")


def number_list(values: Iterable[int]) -> str:
    """Whole numbers in ascending order, three or more consecutive ones as a range, such as `0 to 4, 7, 9`."""
    runs: list[list[int]] = []
    for value in sorted(values):
        if runs and value == runs[-1][-1] + 1:
            runs[-1].append(value)
        else:
            runs.append([value])
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)


def concise(value: float, u: float) -> str:
    """A value with one digit of its standard uncertainty in brackets, such as `0.04(1)`."""
    decimals = max(0, -math.floor(math.log10(u))) if u > 0.0 else 4
    digit = round(u * 10**decimals)
    if digit == 10 and decimals:
        decimals, digit = decimals - 1, 1
    return f"{value:.{decimals}f}({digit})"
