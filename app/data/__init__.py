"""Data for scripts and notebooks: the dataset of a journal, a file or a simulation; comparison, conversion, plots, reports."""
