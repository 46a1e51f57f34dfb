"""A reader of archives by the rule of docs/exchange/archive.md, with h5py and numpy alone: `python -I archive_reader.py FILE`.

It prints JSON: the modules of goniotwin that are loaded (none), and of each part the values with their u, and the reflectances.
"""

import json
import sys
from typing import Any

import h5py
import numpy as np


def effects(part: Any, weight: Any) -> tuple[Any, float]:
    """The effects (inputs,) of all inputs on a weighted sum of values, and the variance that no other value shares."""
    total = np.zeros(1 + max(part["dense_input"][()].max(), part["grouped_input"][()].max()))
    np.add.at(total, part["dense_input"][()], weight @ part["dense"][()])
    member, grouped = part["grouped_input"][()], weight[:, None] * part["grouped"][()]
    np.add.at(total, member[member >= 0], grouped[member >= 0])
    return total, float(np.sum((weight[:, None] * part["independent"][()]) ** 2))


def uncertainty(part: Any, weight: Any, *own: float) -> float:
    """The standard uncertainty of a weighted sum of values with errors of its own."""
    shared, alone = effects(part, weight)
    return float(np.sqrt(np.sum(shared**2) + alone + np.sum(np.square(own))))


def part_of(part: Any) -> dict[str, Any]:
    """The u of each value, NaN without one, and the reflectances by light, sigma and wavelength."""
    values = part["values"][()]
    having, found = np.isfinite(values), []
    for each in (part[name] for name in part if name.startswith("reflectance_")):
        weight, about = np.zeros(values.size), each.attrs
        weight[each["index"][()]] = each["weight"][()]
        u = uncertainty(part, weight, about["u_interpolation"], about["u_filled"])
        value = float(np.sum((weight * values)[weight != 0.0]))
        place = bool(about["transmitted"]), float(about["sigma_deg"]), float(about["wavelength_nm"])
        found.append([*place, value, u])
    each_u = [uncertainty(part, row) if known else np.nan for row, known in zip(np.eye(values.size), having, strict=True)]
    return {"u": each_u, "second": int(np.sum(part["second_row"][()] >= 0)), "reflectances": found}


if __name__ == "__main__":
    with h5py.File(sys.argv[1]) as file:
        parts = [part_of(each) for name, each in file["entry"].items() if name.startswith("part_") and "dense" in each]
    print(json.dumps({"loaded": [name for name in sys.modules if name.partition(".")[0] == "goniotwin"], "parts": parts}))
