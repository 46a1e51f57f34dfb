"""Errors of devices. Each names the device, the action, what happened and what to do."""

import logging
from dataclasses import dataclass

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class FaultText:
    """A fault for people: a `headline` in an operator's words, and the `detail` of the wire; empty if the headline has all."""

    headline: str
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.headline} ({self.detail})" if self.detail else self.headline


class DeviceError(Exception):
    """A device failed: `device`, the action (`doing`), what `happened`, and the `remedy`."""

    plain: tuple[str, str] | None = None
    """What happened in an operator's words, in the singular and the plural, where `doing` and `happened` are the wire's."""

    def __init__(self, device: str, doing: str, happened: str, remedy: str = "") -> None:
        self.device = device
        self.doing = doing
        self.happened = happened
        self.remedy = remedy
        text = f"{device}: {doing}: {happened}"
        super().__init__(f"{text}; {remedy}" if remedy else text)
        LOG.debug("%s: %s", type(self).__name__, text)  # here, because a driver repeats some exchanges and raises nothing

    def in_words(self, device: str, *, plural: bool = False) -> FaultText:
        """The fault for people; `device` is the device in an operator's words, as `Rig.plain_name` gives it."""
        if self.plain is None:
            return FaultText(str(self))
        headline = f"{device} {self.plain[plural]}"
        return FaultText(f"{headline}: {self.remedy}" if self.remedy else headline, f"{self.doing}: {self.happened}")


class NoAnswer(DeviceError):
    """The device is not responding: no reply, or an incomplete one, before the deadline."""

    plain = ("is not responding", "are not responding")


class BadAnswer(DeviceError):
    """The reply is corrupted or does not belong to the request."""

    plain: tuple[str, str] | None = ("has sent a wrong or damaged reply", "have sent a wrong or damaged reply")


class WrongDevice(BadAnswer):
    """Another device responds than that of the rig file."""

    plain = None


class Refused(DeviceError):
    """The device received the request and rejected it."""

    plain = ("has refused a command", "have refused a command")


class Overrange(DeviceError):
    """What is measured exceeds the range of the instrument."""

    plain = ("is overrange", "are overrange")


class LimitError(DeviceError):
    """A target outside the limits of an axis; nothing was sent."""


class Forgotten(DeviceError):
    """The device responds but has lost its settings: it has reset, or its settings were changed elsewhere."""

    plain = ("has lost its settings", "have lost their settings")


class Taken(Forgotten):
    """Another program has connected to the device since: it has the settings of that program, and is left to it."""

    plain = ("is in use by another program", "are in use by another program")


class Interrupted(DeviceError):
    """A motion that was not sent because a stop was requested."""


class Unreferenced(DeviceError):
    """The axis is unreferenced: it moves to no angle until it is homed or its position is set."""


def unless_late(late_s: float, patience_s: float, happened: str, remedy: str = "") -> tuple[str, str]:
    """What happened in a wait of `patience_s`, and the remedy: the cable, or this computer if it was late by half of that."""
    if late_s < 0.5 * patience_s:
        return happened, remedy
    return f"{happened}, and this computer was busy: {late_s:.2g} s late", "close other programs and try again"
