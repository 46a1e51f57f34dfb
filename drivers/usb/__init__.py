"""USB: USBTMC instruments on pyusb, and USB devices of other computers over USB/IP.

`UsbTmc` is the wire to one instrument; `find_usbip` finds a device that a USB/IP server exports.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.drivers.usb.usbip import UsbIpBackend as UsbIpBackend
    from goniotwin.drivers.usb.usbip import find_usbip as find_usbip
    from goniotwin.drivers.usb.usbtmc import UsbOpener as UsbOpener
    from goniotwin.drivers.usb.usbtmc import UsbTmc as UsbTmc
else:
    __getattr__ = first_use(
        __name__,
        {
            "usbip": ("UsbIpBackend", "find_usbip"),
            "usbtmc": ("UsbOpener", "UsbTmc"),
        },
    )
