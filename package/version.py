"""The version of goniotwin, as it is installed."""

from importlib.metadata import version

__version__ = version("goniotwin")
