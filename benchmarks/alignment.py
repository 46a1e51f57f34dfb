"""Random misaligned rigs, and what an alignment finds of them.

    python -m benchmarks.alignment [--rigs 50] [--first 1] [--wires] [--json]

Each rig has 12 tilts within 0.1 deg, zeros of sigma, beta and shift within 0.2 deg, photodiodes' angles within 0.02 deg, and
positions of the axes within 0.005 deg after each move; it measures examples/proof/alignment.toml. The truth is that of the
twin itself. Some ten seconds a rig without wires.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.studies.alignment import LEAST_DARK
from tests.app.campaign.studies.alignment_bench import RigFindings, find

CUTS = ("measured", "corrected", "aligned")


def summary(rigs: list[RigFindings]) -> dict[str, object]:
    """Medians and means over the rigs."""
    common = min(len(each.errors) for each in rigs)
    errors, u = np.abs([each.errors[:common] for each in rigs]), np.array([each.u[:common] for each in rigs])
    cuts = np.array([each.cuts_percent for each in rigs])
    return {
        "rigs": len(rigs),
        "rows": max(each.rows for each in rigs),
        "combinations": [len(each.errors) for each in rigs],
        "median_error_deg": np.median(errors, axis=0).tolist(),
        "median_u_deg": np.median(u, axis=0).tolist(),
        "chi2_combinations": float(np.mean((errors / u) ** 2)),
        "median_direction_deg": float(np.median([each.direction for each in rigs])),
        "largest_direction_deg": float(np.max([each.direction for each in rigs])),
        "median_direction_from_nominal_deg": float(np.median([each.from_nominal for each in rigs])),
        "chi2_predictions": float(np.mean([each.predictions for each in rigs])),
        "chi2_predictions_lit": float(np.mean([each.predictions for each in rigs if each.dark <= LEAST_DARK] or [np.nan])),
        "lit": sum(each.dark <= LEAST_DARK for each in rigs),
        "chi2_residuals": float(np.mean([each.residuals for each in rigs])),
        "median_cut_rms_percent": dict(zip(CUTS, np.median(cuts, axis=0).tolist(), strict=True)),
        "median_corrected_less_aligned_percent": float(np.median(cuts[:, 1] - cuts[:, 2])),
        "median_corrected_against_aligned_percent": float(np.median([each.cut_percent for each in rigs])),
        "findings": {each.seed: list(each.findings) for each in rigs if each.findings},
    }


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=50)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--wires", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rigs = []
    for seed in range(arguments.first, arguments.first + arguments.rigs):
        with tempfile.TemporaryDirectory() as folder:
            rigs.append(find(seed, Path(folder), wires=arguments.wires))
        if not arguments.json:
            worst, directions = max(map(abs, rigs[-1].errors)), rigs[-1].direction
            print(f"rig {seed}: largest error {worst:.4f} deg, directions {directions:.4f} deg", flush=True)
    found = summary(rigs)
    if arguments.json:
        print(json.dumps(found))
        return
    for key, value in found.items():
        shown = [float(f"{each:.2g}") for each in value] if isinstance(value, list) else value
        print(f"{key}: {shown}")


if __name__ == "__main__":
    main()
