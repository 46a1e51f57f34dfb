"""What a row does, in words. No Qt."""

from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.wording import rounded_duration_text


def row_words(row: Row) -> str:
    """A row in words: `Measuring satin, σ 30°, γ 0°, β 180°, shift 2.5°, 550 nm`."""
    sample = "an empty sample unit" if row.sample == NO_SAMPLE else row.sample
    match row.kind:
        case "mount":
            return f"Mounting {sample}"
        case "dark":
            return f"Dark reading with the shutter closed, at {sample}"
        case "warm-up":
            return f"Warming up the lamp, at most {rounded_duration_text(row.longest_s)}"
    what = "Drift check of" if row.kind == "drift" else "Measuring"
    return ", ".join([f"{what} {sample}", *_pose_words(row)])


def _pose_words(row: Row) -> list[str]:
    wavelength = [] if row.wavelength_nm is None else [f"{row.wavelength_nm:g} nm"]
    if row.pose is None:
        return wavelength
    gamma, sigma, beta, shift = row.pose
    return [f"σ {sigma:g}°", f"γ {gamma:g}°", f"β {beta:g}°", f"shift {shift:g}°", *wavelength]
