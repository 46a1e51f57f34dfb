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


class Taken(Forgotten):
    """Another program has connected to the device since: it has the settings of that program, and is left to it."""


class Interrupted(DeviceError):
    """A motion that was not sent because a stop was requested."""


class Unreferenced(DeviceError):
    """The axis is unreferenced: it moves to no angle until it is homed or its position is set."""


def unless_late(late_s: float, patience_s: float, happened: str, remedy: str = "") -> tuple[str, str]:
    """What happened in a wait of `patience_s`, and the remedy: the cable, or this computer if it was late by half of that."""
    if late_s < 0.5 * patience_s:
        return happened, remedy
    return f"{happened}, and this computer was busy: {late_s:.2g} s late", "close other programs and try again"
