"""Scattering models of samples: analytic, tabulated, from scattered points, and combinations of them."""
