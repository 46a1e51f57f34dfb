"""What a file is, of what, how complete, and whether it is simulated: for `goniotwin info`."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.polarisation import light_words
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.data.conversion import is_journal, shares_of
from goniotwin.app.data.opening import with_files_beside
from goniotwin.app.formats import BsdfTable, registry
from goniotwin.app.formats.content import UNTRUSTED, Part, RegularTable, ScatteredBsdf, flagged
from goniotwin.app.formats.registry import BSDF, Holds
from goniotwin.app.rig import parse_rig
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import round_deg

MOST_LISTED = 12
"""Angles or wavelengths that are listed one by one."""
FEW = 4
"""Incidences for which the polarisation of the light is listed; of more, for the first and the last."""


def information(path: Path) -> dict[str, Any]:
    """What is known of a file, for JSON. Raises UserError."""
    if is_journal(path):
        return {"file": str(path), "format": "journal", "title": "data file of a campaign", **_of_journal(path)}
    found = registry.recognise(path, BSDF | {Holds.RAYS})
    result: dict[str, Any] = {"file": str(path), "format": found.name, "title": found.title}
    if Holds.RAYS in found.holds:
        found.read(path)  # it is whole
        return {**result, "simulated": True}
    content = found.read(path)
    if (described := registry.described_table(content)) is None:
        content = with_files_beside(path, content, found)
    return {
        **result,
        "simulated": content.simulated,
        "stands_for": described,
        "parts": [_of_part(part) for part in content.parts],
        "metadata": (content.of(content.samples[0]) if len(content.samples) == 1 else content).metadata.as_dict(),
        "metadata_of_samples": {name: each.as_dict() for name, each in content.of_samples.items()},
        "comments": sum(len(each.comments) for each in (content, *content.parts)),
    }


def _of_journal(path: Path) -> dict[str, Any]:
    summary = campaign_summary(path)
    with Journal.open(path) as journal:
        schedule = parse_schedule(journal.value("schedule"), f"{path} (schedule)").file
        rig = parse_rig(journal.value("rig"), Path(), f"{path} (rig)")
        done = journal.committed_numbers()
        rows = [row for row in journal.planned_rows() if row.kind == "measure"]
    sigma = np.array(sorted(grid_values(schedule.sigma_deg)))
    planned, measured = Counter(row.sample for row in rows), Counter(row.sample for row in rows if row.number in done)
    return {
        **summary.as_dict(),
        "damage": summary.damage,
        "samples": [
            {"sample": name, "rows": measured[name], "planned": planned[name]} for name in schedule.samples if planned[name]
        ],
        "etalon": schedule.etalon,
        "second_standard": None if schedule.second_standard is None else schedule.second_standard.name,
        "light": ["reflected", "transmitted"] if schedule.light == "both" else [schedule.light],
        "side": ["front", "back"] if schedule.side == "both" else [schedule.side],
        "symmetry": schedule.symmetry,
        "polarisation": light_words(rig.file.light, sigma if sigma.size <= FEW else sigma[[0, -1]]),
        "sigma_deg": _listed(sigma),
        "gamma_deg": _listed(np.array(grid_values(schedule.gamma_deg))),
        "wavelengths_nm": _listed(np.array(grid_values(schedule.wavelength_nm))),
    }


def _of_part(part: Part) -> dict[str, Any]:
    size = int(part.values.size)
    with_u = 0 if part.u is None else int(np.count_nonzero(np.isfinite(part.u)))
    found: dict[str, Any] = {
        "sample": part.sample,
        "kind": _kind(part),
        "light": ["transmitted" if each else "reflected" for each in np.unique(part.transmitted).tolist()],
        "side": ["back" if each else "front" for each in np.unique(part.back).tolist()],
        "simulated": part.generated,
        "values": size,
        "with_uncertainty": with_u,
        "sigma_deg": _listed(part.sigma_deg),
        "psi_deg": _listed(part.psi_deg),
    }
    if isinstance(part, ScatteredBsdf):
        trusted = np.isfinite(part.values) & ~flagged(part.flags, UNTRUSTED)
        words, counts = np.unique(
            [word for flags in part.flags[part.flags != ""] for word in flags.split()], return_counts=True
        )
        theta, _ = part.specular()
        return {
            **found,
            "measured": int(np.count_nonzero(trusted)),
            "flags": dict(zip(words.tolist(), counts.tolist(), strict=True)),
            "wavelengths_nm": _listed(part.wavelength_nm[np.isfinite(part.wavelength_nm)]),
            "colours": sorted(set(part.channel.tolist()) - {""}),
            "polar_deg": _range(part.polar_deg),
            "theta_deg": _range(theta),
        }
    found |= {"wavelengths_nm": _listed(np.array(part.wavelengths_nm or ())), "colours": list(part.colours)}
    if isinstance(part, BsdfTable):
        measured = size if part.known is None else int(np.count_nonzero(part.known))
        shares = [vars(share) for share in shares_of(part)]
        found |= {"measured": measured, "not_measured": shares if part.known is not None else None}
        found |= {"phi_deg": _range(part.phi_deg), "theta_deg": _range(part.theta_deg)}
    return found


def _kind(part: Part) -> str:
    if isinstance(part, RegularTable):
        return "regular"
    return "grid" if isinstance(part, BsdfTable) else "points"


def _listed(values: Floats) -> list[float] | dict[str, float]:
    """The numbers, each once; of many the first, the last and how many."""
    distinct = np.unique(round_deg(values))
    return distinct.tolist() if distinct.size <= MOST_LISTED else _range(distinct)


def _range(values: Floats) -> dict[str, float]:
    distinct = np.unique(round_deg(values))
    if not distinct.size:
        return {"count": 0}
    return {"first": float(distinct[0]), "last": float(distinct[-1]), "count": int(distinct.size)}


def information_lines(found: dict[str, Any]) -> list[str]:
    """The same in words."""
    mark = "SIMULATED, " if found["simulated"] else ""
    lines = [f"{found['file']}: {mark}{found['format']}, {found['title']}"]
    if found["format"] == "journal":
        left = f", {found['skipped']} skipped" if found["skipped"] else ""
        lines.append(f"campaign {found['name']}: {found['state']}, {found['rows']} of {found['planned']} rows measured{left}")
        return [*lines, *_journal_lines(found)]
    if found.get("stands_for"):
        lines.append(f"it has {found['stands_for']}, not values")
    for part in found.get("parts", ()):
        lines += _part_lines(part)
    common = _metadata_lines(found.get("metadata", {}))
    lines += common
    for name, entries in found.get("metadata_of_samples", {}).items():
        if own := [line for line in _metadata_lines(entries) if line not in common]:
            lines += [f"{name}:", *own]
    return lines


def _journal_lines(found: dict[str, Any]) -> Iterator[str]:
    light = f"{' and '.join(found['light'])} light on the {' and '.join(found['side'])}"
    for each in found["samples"]:
        yield f"{each['sample']}: {light}, stated as {found['symmetry']}, {each['rows']} of {each['planned']} rows measured"
    for name, unit in (("sigma_deg", "deg"), ("gamma_deg", "deg"), ("wavelengths_nm", "nm")):
        yield f"  {name.rpartition('_')[0]}: {_text(found[name])} {unit}"
    yield f"  {found['polarisation']}"
    if found["damage"]:
        yield f"differs from what was measured: {found['damage']}"


def _part_lines(part: dict[str, Any]) -> list[str]:
    light = f"{' and '.join(part['light'])} light on the {' and '.join(part['side'])}"
    lines = [f"{part['sample'] or 'sample without a name'}: {part['kind']}, {light}"]
    for name, unit in (("sigma_deg", "deg"), ("psi_deg", "deg"), ("wavelengths_nm", "nm"), ("theta_deg", "deg")):
        if text := _text(part.get(name)):
            lines.append(f"  {name.rpartition('_')[0]}: {text} {unit}")
    if part["colours"]:
        lines.append(f"  colours: {', '.join(part['colours'])}")
    measured = f", {part['measured']} measured" if part.get("measured") not in (None, part["values"]) else ""
    lines.append(f"  {part['values']} values{measured}, {part['with_uncertainty']} with an uncertainty")
    if part.get("flags"):
        lines.append(f"  flags: {', '.join(f'{name} {count}' for name, count in part['flags'].items())}")
    if shares := part.get("not_measured"):
        most = max(shares, key=lambda each: each["share"])
        lines.append(f"  not measured: at most {100.0 * most['share']:.3g} % of the light, at sigma {most['sigma_deg']:g}")
    return lines


def _text(values: Any) -> str:
    if isinstance(values, dict):
        return f"{values['count']} from {values['first']:g} to {values['last']:g}" if values["count"] else ""
    return ", ".join(f"{each:g}" for each in values or ())


def _metadata_lines(entries: dict[str, Any]) -> list[str]:
    from goniotwin.app.formats.metadata import metadata_from_dict

    return [f"  {line}" for line in metadata_from_dict(entries).lines()]
