"""The instrument's geometry: coordinates, mirrors, sensor, sample frames, deviations, the scene at a pose."""
