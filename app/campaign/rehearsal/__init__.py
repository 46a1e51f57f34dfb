"""A whole campaign on the twin, on the virtual clock, before anyone measures."""
