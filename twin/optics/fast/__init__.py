"""The fast estimator: from the detectors back to the exit pupil, for a sample whose BSDF is known."""
