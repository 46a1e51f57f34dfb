"""Data of campaigns, simulations and files: one type in memory, formats, comparison and reports."""
