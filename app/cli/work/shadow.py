"""The map of the directions that the mirror unit blocks."""

from pathlib import Path

from goniotwin.app.cli.output import answer
from goniotwin.app.cli.work.virtual_instrument import instrument_and_frames
from goniotwin.app.simulation.detectors import parse_list
from goniotwin.app.simulation.shadow import shadow_maps, write_shadows


def map_shadow(out: Path, sigma: str, step: float, rig: Path | None, as_json: bool) -> None:
    """Write the shadow at angles of the mirror unit. Raises UserError."""
    maps = shadow_maps(instrument_and_frames(rig)[0], [float(each) for each in parse_list(sigma, "--sigma", 0.0, 180.0)], step)
    write_shadows(maps, out)
    blocked = {
        f"{each.sigma_deg:g} {'lower' if each.lower else 'upper'}": int((each.visible[:, :-1] < 1.0).sum()) for each in maps
    }
    result = {
        "file": out,
        "simulated": True,
        "obstruction": maps[0].obstruction,
        "step_deg": step,
        "hidden_in_part": blocked,
    }
    counts = "; ".join(f"sigma {name}: {count}" for name, count in blocked.items())
    text = f"SIMULATED, the shadow of the mirror unit: {out}\ndirections blocked, at least in part: {counts}"
    answer(as_json, result, lambda: print(text))
