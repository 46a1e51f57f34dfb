"""The optics of the virtual prototype: geometry, scattering samples, and two estimators of what each detector gets.

`throughput` is the fast estimator, for a sample whose BSDF is known; `forward` traces everything from the exit pupil on
and is the reference that holds the fast one. `IlluminationUnit` is what stands before the exit pupil, with its own two:
`forward_illumination` and `adjoint_illumination`. Only numpy, numba and the standard library are below: files are
app/formats' business.
"""

from goniotwin.twin.optics.beam import Illumination
from goniotwin.twin.optics.combined import sided, spectral, summed
from goniotwin.twin.optics.correction import CorrectionUnit
from goniotwin.twin.optics.deviation import Deviation
from goniotwin.twin.optics.fast import luminance_factor, luminance_factors, spectral_throughput, throughput
from goniotwin.twin.optics.forward import Estimate, forward
from goniotwin.twin.optics.frames import arc_direction, from_specular, light_direction, specular_direction, to_specular
from goniotwin.twin.optics.holder import SampleFrames
from goniotwin.twin.optics.illumination import IlluminationUnit
from goniotwin.twin.optics.illumination_adjoint import adjoint_illumination
from goniotwin.twin.optics.illumination_figure import IlluminationFigure, illumination_figure
from goniotwin.twin.optics.illumination_forward import forward_illumination
from goniotwin.twin.optics.instrument import Instrument
from goniotwin.twin.optics.lobes import Lobe
from goniotwin.twin.optics.mirrors import pupil_image
from goniotwin.twin.optics.obstruction import visible_fraction
from goniotwin.twin.optics.rayset import Rayset, RaySource, record, replay
from goniotwin.twin.optics.reflectance import Reflectance
from goniotwin.twin.optics.scattered import scattered
from goniotwin.twin.optics.scatterer import Scatterer, albedo, draw, evaluate, lobe_shares
from goniotwin.twin.optics.scattering import gaussian, lambertian, regular
from goniotwin.twin.optics.score import Pose
from goniotwin.twin.optics.sensor import RealSensor
from goniotwin.twin.optics.shadow_map import ShadowMap, shadow_map
from goniotwin.twin.optics.spectrum import Spectrum, luminous, xenon
from goniotwin.twin.optics.stray import StrayMap, stray, stray_throughput
from goniotwin.twin.optics.tabulated import spectral_table, tabulated

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
