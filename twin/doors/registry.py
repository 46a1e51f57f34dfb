"""Virtual rigs by name, so that a `twin://NAME/ADDRESS` leads to one of the several that may live at once."""

import threading
from urllib.parse import urlsplit

from goniotwin.twin.rig import VirtualRig

SCHEME = "twin"
_lock = threading.Lock()
_rigs: dict[str, VirtualRig] = {}


class NoSuchTwin(LookupError):
    """An address at which there is no virtual device."""


def register(name: str, rig: VirtualRig) -> str:
    """Makes a rig reachable; returns its name, which is `name` with a number where that is taken."""
    with _lock:
        chosen, number = name, 2
        while chosen in _rigs:
            chosen, number = f"{name}-{number}", number + 1
        _rigs[chosen] = rig
        return chosen


def unregister(name: str) -> None:
    """Its addresses lead nowhere from now on."""
    with _lock:
        _rigs.pop(name, None)


def split(address: str) -> tuple[str, str]:
    """Rig and device of an address such as `twin://virtual/axes`. Raises NoSuchTwin for another form."""
    parts = urlsplit(address)
    device = parts.path.strip("/")
    if parts.scheme != SCHEME or not parts.netloc or not device:
        raise NoSuchTwin(f"{address!r} is not of the form twin://RIG/DEVICE")
    return parts.netloc, device


def find(address: str) -> tuple[VirtualRig, str]:
    """The rig that an address leads to, and the device's name in it. Raises NoSuchTwin."""
    name, device = split(address)
    with _lock:
        rig = _rigs.get(name)
    if rig is None:
        raise NoSuchTwin(f"no virtual rig {name!r} is open in this program, so there is nothing at {address}")
    return rig, device


def missing(address: str, known: dict[str, object]) -> NoSuchTwin:
    """The error for a device that the rig does not have on this bus."""
    return NoSuchTwin(f"nothing at {address}; on this bus there are: {', '.join(sorted(known)) or 'none'}")
