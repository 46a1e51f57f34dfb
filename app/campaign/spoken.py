"""Times as people say them."""


def clock_time(seconds: float) -> str:
    """Hours, minutes and seconds, to be read."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours} h {minutes:02d} min {whole % 60:02d} s" if hours else f"{minutes} min {whole % 60:02d} s"
