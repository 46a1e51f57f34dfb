"""The optics of the virtual prototype: geometry, scattering samples, and two estimators of the light on each detector.

`throughput` is the fast estimator, for a sample with a known BSDF. `forward_throughput` traces rays from the exit pupil to the
detectors; it is the reference for the fast one. `IlluminationUnit` is the optics before the exit pupil, with two estimators of
its own: `forward_illumination` and `adjoint_illumination`; `field_fluxes` evaluates many sets of its deviations at once. This
package needs numpy and numba alone, and annotated-types, a module of names for bounds: files are read and written in
app/formats.
"""

from goniotwin.twin.optics.bsdf.analytic_samples import anisotropic_gaussian, gaussian, lambertian, regular, ward, wide_tailed
from goniotwin.twin.optics.bsdf.lobes import Lobe
from goniotwin.twin.optics.bsdf.point_samples import scattered_points
from goniotwin.twin.optics.bsdf.scatterer import (
    Scatterer,
    albedo,
    apply_spectrum,
    combine_sides,
    draw_directions,
    evaluate,
    lobe_shares,
    sum_samples,
    without_regular,
)
from goniotwin.twin.optics.bsdf.table_samples import spectral_table, table_sample
from goniotwin.twin.optics.fast.estimator import luminance_factor, luminance_factors, spectral_throughput, throughput
from goniotwin.twin.optics.fast.obstruction import ShadowMap, shadow_map, visible_fraction, visible_fraction_of_few
from goniotwin.twin.optics.fast.scenes import Pose, Poses, Scenes
from goniotwin.twin.optics.fast.surrogate import Surrogate, factor_blocks
from goniotwin.twin.optics.forward.estimator import Estimate, forward_throughput
from goniotwin.twin.optics.forward.stray_light import StrayMap, stray_map, stray_throughput
from goniotwin.twin.optics.geometry.coordinates import (
    arc_direction,
    from_specular,
    light_direction,
    specular_direction,
    to_specular,
)
from goniotwin.twin.optics.geometry.deviation import Deviation
from goniotwin.twin.optics.geometry.instrument import Dimensions, Instrument, Reflectance, SampleFrames, deviation_array
from goniotwin.twin.optics.geometry.mirrors import pupil_image
from goniotwin.twin.optics.geometry.sensor import RealSensor
from goniotwin.twin.optics.illumination.adjoint import IlluminationFigure, adjoint_illumination, illumination_figure
from goniotwin.twin.optics.illumination.beam import Illumination
from goniotwin.twin.optics.illumination.field_flux import field_fluxes
from goniotwin.twin.optics.illumination.forward import forward_illumination
from goniotwin.twin.optics.illumination.rayset import Rayset, RaySource, record, replay
from goniotwin.twin.optics.illumination.spectrum import Spectrum, luminous_spectrum, xenon_spectrum
from goniotwin.twin.optics.illumination.unit import IlluminationUnit

__all__ = [
    "Deviation",
    "Dimensions",
    "Estimate",
    "Illumination",
    "IlluminationFigure",
    "IlluminationUnit",
    "Instrument",
    "Lobe",
    "Pose",
    "Poses",
    "RaySource",
    "Rayset",
    "RealSensor",
    "Reflectance",
    "SampleFrames",
    "Scatterer",
    "Scenes",
    "ShadowMap",
    "Spectrum",
    "StrayMap",
    "Surrogate",
    "adjoint_illumination",
    "albedo",
    "anisotropic_gaussian",
    "apply_spectrum",
    "arc_direction",
    "combine_sides",
    "deviation_array",
    "draw_directions",
    "evaluate",
    "factor_blocks",
    "field_fluxes",
    "forward_illumination",
    "forward_throughput",
    "from_specular",
    "gaussian",
    "illumination_figure",
    "lambertian",
    "light_direction",
    "lobe_shares",
    "luminance_factor",
    "luminance_factors",
    "luminous_spectrum",
    "pupil_image",
    "record",
    "regular",
    "replay",
    "scattered_points",
    "shadow_map",
    "spectral_table",
    "spectral_throughput",
    "specular_direction",
    "stray_map",
    "stray_throughput",
    "sum_samples",
    "table_sample",
    "throughput",
    "to_specular",
    "visible_fraction",
    "visible_fraction_of_few",
    "ward",
    "wide_tailed",
    "without_regular",
    "xenon_spectrum",
]
