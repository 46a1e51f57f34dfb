"""Virtual USB: the twin's devices found by programs that know nothing of it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import usb.backend.libusb1
from usb.backend import IBackend


@contextmanager
def installed(backend: IBackend) -> Iterator[None]:
    """Meanwhile `usb.core.find()` without a backend of its own finds the devices of `backend`, in this process."""
    real: Callable[..., IBackend | None] = usb.backend.libusb1.get_backend
    usb.backend.libusb1.get_backend = lambda find_library=None: backend  # noqa: ARG005  (pyusb's own signature)
    try:
        yield
    finally:
        usb.backend.libusb1.get_backend = real
