"""Mock hardware: twin devices on real endpoints (serial, TCP, USB), for programs written for real devices."""

from goniotwin.mocks.usb_endpoints import install_backend as install_backend
