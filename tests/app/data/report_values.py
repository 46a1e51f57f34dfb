"""The values in a report's text, held against those of an export."""

import csv
import math
import re
from pathlib import Path

from goniotwin.app.formats.content import UNTRUSTED


def check_report_values(text: str, exported: Path) -> int:
    """Check that a report's text has, of each setting, the counts and the largest value of an exported CSV file of one sample.

    A good value in the specular direction is in it too, with U (k = 2), as BSDF and as luminance factor. Returns their number.
    """
    lines = [each for each in exported.read_text(encoding="utf-8").splitlines() if not each.startswith("#")]
    settings: dict[tuple[float, float], list[dict[str, str]]] = {}
    for row in csv.DictReader(lines):
        settings.setdefault((float(row["wavelength_nm"]), float(row["sigma_deg"])), []).append(row)
    assert settings
    specular = 0
    for (nm, sigma), rows in settings.items():
        good = [each for each in rows if each["bsdf_per_sr"] not in ("", "nan") and UNTRUSTED.isdisjoint(each["flags"].split())]
        largest = max(float(each["bsdf_per_sr"]) for each in good)
        assert re.search(rf"reflected {nm:g} nm {sigma:g} {len(rows)} {len(good)} \d+ {largest:.4g} ", text), (nm, sigma)
        for each in (each for each in good if abs(float(each["theta_deg"])) < 1e-6):
            value, u = float(each["bsdf_per_sr"]), float(each["u_bsdf_per_sr"])
            four = f"{value:#.4g} {2.0 * u:#.2g} {math.pi * value:#.4g} {2.0 * math.pi * u:#.2g}"
            assert f"specular reflected {nm:g} {sigma:g}° {sigma:g}° 180° {four} measured" in text
            specular += 1
    return specular
