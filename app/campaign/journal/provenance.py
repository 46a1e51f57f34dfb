"""With what a campaign was measured: versions, for the journal and whatever is derived from it."""

import platform
from importlib.metadata import version

PACKAGES = ("goniotwin", "numpy", "numba", "pyserial", "pymodbus", "pyusb")


def versions() -> dict[str, str]:
    """Of Python and the packages that the values depend on."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
