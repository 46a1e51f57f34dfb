"""How high an etalon's radiance factor can be: what is higher was written in percent."""

MOST, MOST_NEAR_GRAZING = 1.5, 5.0
"""What is white in every direction has 1, in a broad lobe somewhat more, and only one near grazing much more."""
NEAR_GRAZING_DEG = 60.0


def refuse_percentage(radiance_factor: float, zenith_deg: float = 0.0) -> None:
    """Raises ValueError for a radiance factor that no diffuser has."""
    most = MOST_NEAR_GRAZING if zenith_deg > NEAR_GRAZING_DEG else MOST
    if radiance_factor > most:
        raise ValueError(
            f"a radiance factor of {radiance_factor:g} is above {most:g}, and no diffuser's is (1 is the ideal one); "
            f"if it is in percent, write {0.01 * radiance_factor:g}"
        )
