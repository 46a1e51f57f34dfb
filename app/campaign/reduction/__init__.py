"""The reduction: from a journal's counts to the BSDF with its uncertainty."""
