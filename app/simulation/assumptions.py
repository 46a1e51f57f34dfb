"""What a reader has to know about a simulation's numbers, in words."""

import math

from goniotwin.app.simulation.simulate import Simulation, Task, acting, refracted_axes
from goniotwin.twin.optics.bsdf import GAUSSIAN


def assumptions(found: Simulation) -> list[str]:
    """One line each, for heads of files and for programs."""
    task, instrument = found.task, found.task.instrument
    hidden = "off: no direction is hidden, as if the mirrors let light pass"
    if instrument.obstruction:
        hidden = "on: directions of which the mirrors hide any part have no value"
    way = "transmitted" if task.transmitted else "reflected"
    grid = "as given" if task.polar_deg is not None else "steps of 0.5 deg near the specular direction to 5 deg"
    estimator = "fast: sample, etalon and all wavelengths with the same rays; errors are differences to another set of rays"
    if task.effort.kind == "forward":
        estimator = "forward Monte Carlo: sample and etalon with paths of their own; errors are standard errors of the paths"
    return [
        f"quantity: luminance factor of {way} light (pi times the BSDF), against an ideal diffuser",
        *_gaussians(task),
        f"side: {_side(task)}",
        *_regular(found),
        *_refracted(task),
        f"stray light: {_stray(task)}",
        f"source: {_source(task)}",
        f"spot: {instrument.spot_side_mm:g} x {instrument.spot_side_mm:g} mm on the sample, set by its frame",
        f"divergence: {instrument.divergence_deg:.3f} deg full width",
        f"field: {instrument.field_deg:g} deg full width, {'discs' if instrument.sensor is None else 'sensors with lenses'} of "
        f"{instrument.detector_diameter_mm:g} mm at {instrument.arc_radius_mm:g} mm",
        f"detectors: virtual ones over azimuth and polar angle, {grid}; a monotone cubic between them",
        f"deviations: {'none' if not instrument.deviations else ', '.join(instrument.deviations)}",
        f"obstruction: {hidden}",
        f"estimator: {estimator}",
        "noise: none but the estimator's; fluorescence: none",
    ]


def _side(task: Task) -> str:
    arc = f"detectors on the {'lower' if task.lower else 'upper'} arc"
    if not task.back:
        return f"light on the front, {arc}"
    turned = "phi is that of the sample turned about x"
    return f"light on the back, the mirror unit at 180 deg - sigma, {arc}; sigma is the incidence on the back, {turned}"


def _regular(found: Simulation) -> list[str]:
    peaks = [each.regular for each in found.at if each.regular is not None]
    if not peaks:
        return []
    least, most = (f"{pick(peak.share for peak in peaks):g}" for pick in (min, max))
    share = least if least == most else f"{least} to {most}"
    way = "straight through" if found.task.transmitted else "in the mirror direction"
    lines = [
        f"regular component: {share} of the light goes {way}, theta = 0; its luminance factor is no property of the sample, it "
        "depends on beam, spot, aperture and field",
        f"regular component: what is in this table of it is what these detectors see, within {peaks[0].within_deg:.2f} deg of "
        "theta = 0",
    ]
    gone = [f"{peak.sigma_deg:g}" for peak in peaks if peak.largest_factor is None]
    if gone:
        lines.append(f"regular component: no detector has it at sigma {', '.join(gone)}: hidden, or between them")
    return lines


def _gaussians(task: Task) -> list[str]:
    """Each lobe without doubt, whichever form and quantity its width was given in."""
    lines = []
    for lobe in acting(task):
        if lobe.kind == GAUSSIAN:
            peak, exponent, intensity = lobe.params[:3]
            falls = ", ".join(
                f"to {name} at {math.degrees(math.sqrt(level / exponent)):.4g} deg"
                for name, level in (("1/e", 1.0), ("a half", math.log(2.0)))
            )
            lines.append(
                f"gaussian: the {'intensity' if intensity == 1.0 else 'luminance'} falls {falls}; "
                f"the peak is {peak:.4g} /sr, and {lobe.albedo(0.0):.4g} of the light at normal incidence is scattered"
            )
    return lines


def _refracted(task: Task) -> list[str]:
    axes = [(sigma, axis) for sigma in task.sigma_deg.tolist() for axis in refracted_axes(task, sigma)]
    bent = [f"{axis:.2f} at sigma {sigma:g}" for sigma, axis in axes if axis is not None]
    gone = [f"{sigma:g}" for sigma, axis in axes if axis is None]
    lines = []
    if bent:
        lines.append(
            f"refraction: lobes about the polar angles {', '.join(bent)} deg; theta = 0 stays the straight-through direction, "
            "so give --theta and --phi fine enough there"
        )
    if gone:
        lines.append(f"refraction: total reflection at sigma {', '.join(gone)}: nothing of that lobe is transmitted")
    return lines


def _stray(task: Task) -> str:
    if not task.stray:
        return "left out: only light that was scattered once, by the sample, counts"
    frames = task.frames
    told = (
        f"in: that of frames of {frames.side_mm:g} mm that scatter {frames.reflectance:g} of the light and are lit "
        f"{frames.lit:g} times as wide as their hole, and light that met mirrors, frames or sample again; of sample and etalon"
    )
    if task.effort.kind == "fast":
        told += "; from a map over 5 by 10 deg"
    return told


def _source(task: Task) -> str:
    if task.source is None:
        return "a uniform exit pupil"
    source = task.source
    return f"rayset {source.name} of {source.rays.flux.size} rays, geometry {source.geometry}, at {source.wavelength_nm:g} nm"
