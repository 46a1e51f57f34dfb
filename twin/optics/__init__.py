"""The optics of the virtual prototype: geometry, scattering samples, and two estimators of what each detector gets.

`throughput` is the fast estimator, for a sample whose BSDF is known; `forward` traces everything from the exit pupil on
and is the reference that holds the fast one. `IlluminationUnit` is what stands before the exit pupil, with its own two:
`forward_illumination` and `adjoint_illumination`. Only numpy, numba and the standard library are below: files are
app/formats' business.
"""

from goniotwin.twin.optics.bsdf.analytic_samples import gaussian, lambertian, regular
from goniotwin.twin.optics.bsdf.lobes import Lobe
from goniotwin.twin.optics.bsdf.point_samples import scattered
from goniotwin.twin.optics.bsdf.scatterer import Scatterer, albedo, draw, evaluate, lobe_shares, sided, spectral, summed
from goniotwin.twin.optics.bsdf.table_samples import spectral_table, tabulated
from goniotwin.twin.optics.fast.estimator import luminance_factor, luminance_factors, spectral_throughput, throughput
from goniotwin.twin.optics.fast.lobe_sums import Pose
from goniotwin.twin.optics.fast.obstruction import ShadowMap, shadow_map, visible_fraction
from goniotwin.twin.optics.forward.estimator import Estimate, forward
from goniotwin.twin.optics.forward.stray_light import StrayMap, stray, stray_throughput
from goniotwin.twin.optics.geometry.coordinates import (
    arc_direction,
    from_specular,
    light_direction,
    specular_direction,
    to_specular,
)
from goniotwin.twin.optics.geometry.deviation import Deviation
from goniotwin.twin.optics.geometry.instrument import Instrument, Reflectance, SampleFrames
from goniotwin.twin.optics.geometry.mirrors import pupil_image
from goniotwin.twin.optics.geometry.sensor import RealSensor
from goniotwin.twin.optics.illumination.adjoint import IlluminationFigure, adjoint_illumination, illumination_figure
from goniotwin.twin.optics.illumination.beam import Illumination
from goniotwin.twin.optics.illumination.forward import forward_illumination
from goniotwin.twin.optics.illumination.rayset import Rayset, RaySource, record, replay
from goniotwin.twin.optics.illumination.spectrum import Spectrum, luminous, xenon
from goniotwin.twin.optics.illumination.unit import CorrectionUnit, IlluminationUnit

__all__ = [
    "CorrectionUnit",
    "Deviation",
    "Estimate",
    "Illumination",
    "IlluminationFigure",
    "IlluminationUnit",
    "Instrument",
    "Lobe",
    "Pose",
    "RaySource",
    "Rayset",
    "RealSensor",
    "Reflectance",
    "SampleFrames",
    "Scatterer",
    "ShadowMap",
    "Spectrum",
    "StrayMap",
    "adjoint_illumination",
    "albedo",
    "arc_direction",
    "draw",
    "evaluate",
    "forward",
    "forward_illumination",
    "from_specular",
    "gaussian",
    "illumination_figure",
    "lambertian",
    "light_direction",
    "lobe_shares",
    "luminance_factor",
    "luminance_factors",
    "luminous",
    "pupil_image",
    "record",
    "regular",
    "replay",
    "scattered",
    "shadow_map",
    "sided",
    "spectral",
    "spectral_table",
    "spectral_throughput",
    "specular_direction",
    "stray",
    "stray_throughput",
    "summed",
    "tabulated",
    "throughput",
    "to_specular",
    "visible_fraction",
    "xenon",
]
