"""What goes wrong between the computer and a device, told so that a person can act on it."""


class DeviceError(Exception):
    """A device did not do what it was asked: which device, at what, what happened, and what to do."""

    def __init__(self, device: str, doing: str, happened: str, remedy: str = "") -> None:
        self.device = device
        self.doing = doing
        self.happened = happened
        self.remedy = remedy
        text = f"{device}: {doing}: {happened}"
        super().__init__(f"{text}; {remedy}" if remedy else text)


class NoAnswer(DeviceError):
    """Nothing, or too little, came back in time."""


class BadAnswer(DeviceError):
    """What came back is not the answer to what was asked."""


class Refused(DeviceError):
    """The device understood and will not."""


class LimitError(DeviceError):
    """A target outside the axis' soft limits: nothing was sent."""


class Forgotten(DeviceError):
    """The device answers and no longer has its settings: it has reset, or somebody has changed them."""


class Interrupted(DeviceError):
    """A stop has come between: what was to move has not been told to."""


class Unreferenced(DeviceError):
    """It is in doubt where the axis is, so that it goes to no angle until it is referenced."""
