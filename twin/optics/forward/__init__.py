"""The forward estimator: Monte Carlo from the source to all detectors at once."""
