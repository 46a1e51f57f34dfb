"""From a journal's counts to the BSDF with its uncertainty, and to files."""
