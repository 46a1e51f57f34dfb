"""The measurement model: named inputs, what a value changes with each of them, and what follows for values and integrals."""
