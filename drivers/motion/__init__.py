"""Axes: degrees above, microsteps on the wire; moves, homing, reference, clearance."""
