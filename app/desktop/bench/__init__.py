"""The bench screen: the instrument, its axes and its light, by hand, and readings of the photodiodes."""
