"""USB's standard descriptors, read from their bytes into the names that the specification gives their fields.

pyusb asks its backends for objects with these names. Source: USB 2.0, section 9.6.
"""

import struct
from dataclasses import dataclass, field
from types import SimpleNamespace

DEVICE, CONFIGURATION, STRING, INTERFACE, ENDPOINT = 1, 2, 3, 4, 5
DEVICE_BYTES, CONFIGURATION_BYTES = 18, 9

_FIELDS = {
    DEVICE: (
        "<BBHBBBBHHHBBBB",
        "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 idVendor idProduct "
        "bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations",
    ),
    CONFIGURATION: (
        "<BBHBBBBB",
        "bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration bmAttributes bMaxPower",
    ),
    INTERFACE: (
        "<BBBBBBBBB",
        "bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints bInterfaceClass bInterfaceSubClass "
        "bInterfaceProtocol iInterface",
    ),
    ENDPOINT: ("<BBBBHB", "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval"),
}


class DescriptorError(ValueError):
    """Bytes that are not the descriptors they should be."""


@dataclass(frozen=True)
class Interface:
    """One alternate setting of an interface."""

    fields: SimpleNamespace
    endpoints: list[SimpleNamespace] = field(default_factory=list)


@dataclass(frozen=True)
class Configuration:
    """A configuration with the alternate settings of its interfaces, in their order."""

    fields: SimpleNamespace
    settings: list[Interface] = field(default_factory=list)

    def setting(self, interface: int, alternate: int) -> Interface:
        """Counted from 0, as pyusb counts. Raises IndexError past the last."""
        numbers = list(dict.fromkeys(each.fields.bInterfaceNumber for each in self.settings))
        number = numbers[interface]
        return [each for each in self.settings if each.fields.bInterfaceNumber == number][alternate]


def decode_device(data: bytes, **beside: object) -> SimpleNamespace:
    """A device descriptor; `beside` are further fields. Raises DescriptorError."""
    return _decoded(DEVICE, data, **beside)


def decode_configuration(data: bytes) -> Configuration:
    """A configuration and all that comes with it. Raises DescriptorError."""
    configuration = Configuration(_decoded(CONFIGURATION, data, extra_descriptors=[]))
    rest = data[configuration.fields.bLength :]
    while rest:
        length, kind = rest[0], rest[1] if len(rest) > 1 else 0
        if not 2 <= length <= len(rest):
            raise DescriptorError(f"a descriptor of {length} bytes, of which {len(rest)} are there")
        if kind == INTERFACE:
            configuration.settings.append(Interface(_decoded(kind, rest, extra_descriptors=[])))
        elif kind == ENDPOINT and configuration.settings:
            more = {"bRefresh": 0, "bSynchAddress": 0, "extra_descriptors": []}
            configuration.settings[-1].endpoints.append(_decoded(kind, rest, **more))
        rest = rest[length:]
    return configuration


def decode_string(data: bytes) -> str:
    """A string descriptor's text. Raises DescriptorError."""
    if len(data) < 2 or data[1] != STRING or len(data) < data[0]:
        raise DescriptorError(f"{data[:8].hex(' ')} is no string descriptor")
    return data[2 : data[0]].decode("utf-16-le", "replace")


def _decoded(kind: int, data: bytes, **beside: object) -> SimpleNamespace:
    form, names = _FIELDS[kind]
    size = struct.calcsize(form)
    if len(data) < size or data[0] < size or data[1] != kind:
        raise DescriptorError(f"{data[:size].hex(' ')} is no descriptor of type {kind}")
    return SimpleNamespace(**dict(zip(names.split(), struct.unpack(form, data[:size]), strict=True)), **beside)
