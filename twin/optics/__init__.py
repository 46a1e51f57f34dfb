"""The optics of the virtual prototype: geometry, scattering samples, and two estimators of the light on each detector.

`throughput` is the fast estimator, for a sample with a known BSDF. `forward_throughput` traces rays from the exit pupil to the
detectors; it is the reference for the fast one. `IlluminationUnit` is the optics before the exit pupil, with two estimators of
its own: `forward_illumination` and `adjoint_illumination`; `field_fluxes` evaluates many sets of its deviations at once. This
package needs numpy and numba alone, and annotated-types, a module of names for bounds: files are read and written in
app/formats.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.twin.optics.bsdf.analytic_samples import anisotropic_gaussian as anisotropic_gaussian
    from goniotwin.twin.optics.bsdf.analytic_samples import gaussian as gaussian
    from goniotwin.twin.optics.bsdf.analytic_samples import lambertian as lambertian
    from goniotwin.twin.optics.bsdf.analytic_samples import regular as regular
    from goniotwin.twin.optics.bsdf.analytic_samples import ward as ward
    from goniotwin.twin.optics.bsdf.analytic_samples import wide_tailed as wide_tailed
    from goniotwin.twin.optics.bsdf.evaluation import draw_directions as draw_directions
    from goniotwin.twin.optics.bsdf.evaluation import evaluate as evaluate
    from goniotwin.twin.optics.bsdf.lobes import Lobe as Lobe
    from goniotwin.twin.optics.bsdf.point_samples import scattered_points as scattered_points
    from goniotwin.twin.optics.bsdf.scatterer import Scatterer as Scatterer
    from goniotwin.twin.optics.bsdf.scatterer import albedo as albedo
    from goniotwin.twin.optics.bsdf.scatterer import apply_spectrum as apply_spectrum
    from goniotwin.twin.optics.bsdf.scatterer import combine_sides as combine_sides
    from goniotwin.twin.optics.bsdf.scatterer import lobe_shares as lobe_shares
    from goniotwin.twin.optics.bsdf.scatterer import sum_samples as sum_samples
    from goniotwin.twin.optics.bsdf.scatterer import without_regular as without_regular
    from goniotwin.twin.optics.bsdf.table_samples import spectral_table as spectral_table
    from goniotwin.twin.optics.bsdf.table_samples import table_sample as table_sample
    from goniotwin.twin.optics.fast.estimator import luminance_factor as luminance_factor
    from goniotwin.twin.optics.fast.estimator import luminance_factors as luminance_factors
    from goniotwin.twin.optics.fast.estimator import spectral_throughput as spectral_throughput
    from goniotwin.twin.optics.fast.estimator import throughput as throughput
    from goniotwin.twin.optics.fast.few_rays import visible_fraction_of_few as visible_fraction_of_few
    from goniotwin.twin.optics.fast.obstruction import ShadowMap as ShadowMap
    from goniotwin.twin.optics.fast.obstruction import shadow_map as shadow_map
    from goniotwin.twin.optics.fast.obstruction import visible_fraction as visible_fraction
    from goniotwin.twin.optics.fast.scenes import Pose as Pose
    from goniotwin.twin.optics.fast.scenes import Poses as Poses
    from goniotwin.twin.optics.fast.scenes import Scenes as Scenes
    from goniotwin.twin.optics.fast.surrogate import Surrogate as Surrogate
    from goniotwin.twin.optics.fast.surrogate import factor_blocks as factor_blocks
    from goniotwin.twin.optics.forward.estimator import Estimate as Estimate
    from goniotwin.twin.optics.forward.estimator import forward_throughput as forward_throughput
    from goniotwin.twin.optics.forward.stray_light import StrayMap as StrayMap
    from goniotwin.twin.optics.forward.stray_light import stray_map as stray_map
    from goniotwin.twin.optics.forward.stray_light import stray_throughput as stray_throughput
    from goniotwin.twin.optics.geometry.coordinates import arc_axis as arc_axis
    from goniotwin.twin.optics.geometry.coordinates import arc_direction as arc_direction
    from goniotwin.twin.optics.geometry.coordinates import from_specular as from_specular
    from goniotwin.twin.optics.geometry.coordinates import light_direction as light_direction
    from goniotwin.twin.optics.geometry.coordinates import specular_direction as specular_direction
    from goniotwin.twin.optics.geometry.coordinates import to_specular as to_specular
    from goniotwin.twin.optics.geometry.deviation import Deviation as Deviation
    from goniotwin.twin.optics.geometry.instrument import Dimensions as Dimensions
    from goniotwin.twin.optics.geometry.instrument import Instrument as Instrument
    from goniotwin.twin.optics.geometry.instrument import Reflectance as Reflectance
    from goniotwin.twin.optics.geometry.instrument import SampleFrames as SampleFrames
    from goniotwin.twin.optics.geometry.instrument import deviation_array as deviation_array
    from goniotwin.twin.optics.geometry.mirrors import pupil_image as pupil_image
    from goniotwin.twin.optics.geometry.sensor import RealSensor as RealSensor
    from goniotwin.twin.optics.illumination.adjoint import IlluminationFigure as IlluminationFigure
    from goniotwin.twin.optics.illumination.adjoint import adjoint_illumination as adjoint_illumination
    from goniotwin.twin.optics.illumination.adjoint import illumination_figure as illumination_figure
    from goniotwin.twin.optics.illumination.beam import Illumination as Illumination
    from goniotwin.twin.optics.illumination.field_flux import field_fluxes as field_fluxes
    from goniotwin.twin.optics.illumination.forward import forward_illumination as forward_illumination
    from goniotwin.twin.optics.illumination.rayset import Rayset as Rayset
    from goniotwin.twin.optics.illumination.rayset import RaySource as RaySource
    from goniotwin.twin.optics.illumination.rayset import record as record
    from goniotwin.twin.optics.illumination.rayset import replay as replay
    from goniotwin.twin.optics.illumination.spectrum import Spectrum as Spectrum
    from goniotwin.twin.optics.illumination.spectrum import luminous_spectrum as luminous_spectrum
    from goniotwin.twin.optics.illumination.spectrum import xenon_spectrum as xenon_spectrum
    from goniotwin.twin.optics.illumination.unit import IlluminationUnit as IlluminationUnit
else:
    __getattr__, __dir__ = first_use(__name__)
