"""USBTMC instruments on pyusb, and USB devices over USB/IP."""
