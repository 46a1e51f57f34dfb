"""Mock hardware: twin devices where programs that know nothing of the twin look for real ones."""

from goniotwin.mocks.usb_endpoints import install_backend

__all__ = ["install_backend"]
