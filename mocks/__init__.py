"""Mock hardware: twin devices where programs that know nothing of the twin look for real ones."""

from goniotwin.mocks.usb_endpoints import installed

__all__ = ["installed"]
