"""Monte Carlo: counter-based random numbers, and estimates in chunks on any number of threads."""
