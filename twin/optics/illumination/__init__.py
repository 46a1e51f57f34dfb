"""The illumination unit from the xenon arc to the exit pupil, and its light on the sample."""
