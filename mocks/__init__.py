"""Mock hardware: twin devices where programs that know nothing of the twin look for real ones."""

from mocks.virtual_usb import installed

__all__ = ["installed"]
