"""Figures: their description, the rules of scales, curves and maps, and the back end for files."""
