"""The campaigns screen: the campaigns of a folder and their state."""
