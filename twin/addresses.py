"""Addresses of the devices of a virtual rig: the second part of `twin://RIG/ADDRESS`. Further devices have their own."""

AXES, MONOCHROMATOR, MONITOR = "axes", "mono", "monitor"
CONVERTER = "adc-{}"
CONVERTER_LINE = "adcs"
"""The RTU line of converters."""
