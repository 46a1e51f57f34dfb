"""The rehearsal: a whole campaign on the twin, on the virtual clock, with its forecast and warnings."""
