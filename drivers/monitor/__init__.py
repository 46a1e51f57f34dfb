"""The monitor photodiode behind a SCPI instrument."""
