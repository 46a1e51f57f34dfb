"""The axes as the window writes them."""

GREEK = {"gamma": "γ", "sigma": "σ", "beta": "β", "shift": "Δ"}
"""The letter of each axis, in the order of a pose."""
