"""The optics of the virtual prototype: geometry, scattering samples, and two estimators of what each detector gets.

`throughput` is the fast estimator, for a sample whose BSDF is known; `forward` traces everything from the exit pupil on
and is the reference that holds the fast one. Only numpy, numba and the standard library are below: files are
app/formats' business.
"""

from twin.optics.fast import luminance_factor, throughput
from twin.optics.forward import Estimate, forward
from twin.optics.frames import arc_direction, from_specular, light_direction, specular_direction, to_specular
from twin.optics.instrument import Instrument
from twin.optics.mirrors import pupil_image
from twin.optics.obstruction import visible_fraction
from twin.optics.scattering import Scatterer, albedo, evaluate, gaussian, lambertian, tabulated

__all__ = [
    "Estimate",
    "Instrument",
    "Scatterer",
    "albedo",
    "arc_direction",
    "evaluate",
    "forward",
    "from_specular",
    "gaussian",
    "lambertian",
    "light_direction",
    "luminance_factor",
    "pupil_image",
    "specular_direction",
    "tabulated",
    "throughput",
    "to_specular",
    "visible_fraction",
]
