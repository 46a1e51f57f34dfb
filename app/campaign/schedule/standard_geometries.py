"""The geometries of standards, declared once: for the templates of schedules, and for the values of reports.

All of them are in the plane of incidence, on one side of it: a standard that asks for a ring of directions asks for more.
"""

from dataclasses import dataclass

from goniotwin.twin.optics.geometry.coordinates import polar_and_azimuth


@dataclass(frozen=True)
class StandardGeometry:
    """A geometry by its name: incidence `sigma_deg`, and aspecular angle of the direction, positive towards the normal."""

    name: str
    sigma_deg: float
    aspecular_deg: float = 0.0

    @property
    def theta_phi_deg(self) -> tuple[float, float]:
        """The direction in specular coordinates, deg."""
        theta, phi = polar_and_azimuth(self.aspecular_deg, 0.0)
        return float(theta), float(phi)


COLOUR = (StandardGeometry("45:0", 45.0, 45.0), StandardGeometry("0:45", 0.0, -45.0))
"""Illumination and observation of colours and radiance factors (CIE 15); at sigma 0 the direction is on the specular side."""
ASPECULAR = tuple(StandardGeometry(f"45 as {angle}", 45.0, float(angle)) for angle in (-15, 15, 25, 45, 75, 110))
"""The aspecular set of paints with effect pigments (ASTM E2194, ASTM E2539)."""
GLOSS = tuple(StandardGeometry(f"gloss {sigma}", float(sigma)) for sigma in (20, 60, 85))
"""The directions of gloss (ISO 2813): the specular one, without the apertures."""
STANDARD_GEOMETRIES = (*COLOUR, *ASPECULAR, *GLOSS)
