"""Errors of devices. Each names the device, the action, what happened and what to do."""


class DeviceError(Exception):
    """A device failed: `device`, the action (`doing`), what `happened`, and the `remedy`."""

    def __init__(self, device: str, doing: str, happened: str, remedy: str = "") -> None:
        self.device = device
        self.doing = doing
        self.happened = happened
        self.remedy = remedy
        text = f"{device}: {doing}: {happened}"
        super().__init__(f"{text}; {remedy}" if remedy else text)


class NoAnswer(DeviceError):
    """The device is not responding: no reply, or an incomplete one, before the deadline."""


class BadAnswer(DeviceError):
    """The reply is corrupted or does not belong to the request."""


class Refused(DeviceError):
    """The device received the request and rejected it."""


class LimitError(DeviceError):
    """A target outside the limits of an axis; nothing was sent."""


class Forgotten(DeviceError):
    """The device responds but has lost its settings: it has reset, or its settings were changed elsewhere."""


class Interrupted(DeviceError):
    """A motion that was not sent because a stop was requested."""


class Unreferenced(DeviceError):
    """The axis is unreferenced: it moves to no angle until it is homed or its position is set."""
