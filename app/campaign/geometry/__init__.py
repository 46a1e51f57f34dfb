"""The goniophotometer's geometry: arcs, directions, symmetry, and what the mirror unit blocks."""
