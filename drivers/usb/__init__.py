"""USB: USBTMC instruments on pyusb, and USB devices of other computers over USB/IP.

`UsbTmc` is the wire to one instrument; `find_usbip` finds a device that a USB/IP server exports.
"""
