"""Geometry of the goniophotometer: arcs, directions, symmetry of the sample, blocking by the mirror unit, collision."""
