"""Registers of one motor of a TMCL module: the axis parameters, positions in degrees."""

from collections.abc import Sequence
from dataclasses import dataclass

from goniotwin.drivers.errors import DeviceError
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.motion.tmcl.rules import setting_name
from goniotwin.protocols.tmcl import Command, CommandFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter as Parameter
from goniotwin.protocols.tmcl_parameters import DriverFlag, ErrorFlag

CONFIRMED_EXCHANGES = 2
"""Number of exchanges of a confirmed value: the value and the canary."""


@dataclass(frozen=True)
class Switches:
    """Limit switches at the ends of positive (right) and negative (left) microsteps, and the home switch; True is active."""

    right: bool
    left: bool
    home: bool


class Registers:
    """Axis parameters of one motor. Every call is one exchange unless stated otherwise. All raise DeviceError.

    A *confirmed* value is followed by a read of the canary: the module had its settings when it replied.
    """

    def __init__(self, name: str, module: TmclModule, settings: AxisSettings) -> None:
        self._module = module
        self.settings = settings
        self.name = name
        self.keep_alive_s = module.keep_alive_s
        places = (Parameter.ACTUAL_POSITION, Parameter.ENCODER_POSITION)
        self._places = [self.request(Command.GAP, each) for each in places]

    @property
    def stop_count(self) -> int:
        """Number of stop requests on this line so far."""
        return self._module.stop_count

    def request(self, command: Command, number: int, value: int = 0) -> CommandFrame:
        """A request for this motor."""
        return CommandFrame(self.settings.module, command, number, self.settings.motor, value)

    def exchange(self, command: Command, number: int, value: int = 0) -> int:
        """Send a request and return the value of its reply."""
        return self._module.exchange(self.request(command, number, value))

    def read(self, parameter: Parameter) -> int:
        """Value of an axis parameter (GAP)."""
        return self.exchange(Command.GAP, parameter)

    def write(self, parameter: Parameter, value: int) -> None:
        """Set an axis parameter (SAP)."""
        self.exchange(Command.SAP, parameter, value)

    def note(self, parameters: Sequence[tuple[Parameter, int]]) -> None:
        """Note parameters as they are found, before they are written; one exchange each, two on a line without pauses."""
        found = self._module.found
        if found.asks:
            names = [(setting_name(self.request(Command.SAP, each)), each, str(value)) for each, value in parameters]
            found.note({name: (str(self.read(each)), value) for name, each, value in names})

    def read_confirmed(self, parameter: Parameter) -> int:
        """Confirmed value of an axis parameter, in CONFIRMED_EXCHANGES. Raises Forgotten as well."""
        return self._module.read_confirmed(self.request(Command.GAP, parameter))

    def places_deg(self) -> tuple[float, float | None]:
        """Confirmed positions by the motor's counter and by the encoder, None for an axis without one."""
        if not self.settings.encoder:
            return self.position_deg(), None
        counter, encoder = self._module.read_all_confirmed(self._places)
        return self.settings.angle_deg(counter), self.settings.encoder_angle_deg(encoder)

    def check_canary(self) -> None:
        """Raise Forgotten if the module has reset since it was connected."""
        self._module.check_canary(self.settings.module)

    def position_deg(self) -> float:
        """Confirmed position by the motor's counter."""
        return self.settings.angle_deg(self.read_confirmed(Parameter.ACTUAL_POSITION))

    def encoder_deg(self) -> float | None:
        """Confirmed position by the encoder; None for an axis without encoder."""
        if not self.settings.encoder:
            return None
        return self.settings.encoder_angle_deg(self.read_confirmed(Parameter.ENCODER_POSITION))

    def set_counter(self, microsteps: int) -> None:
        """Set counter and encoder of an axis at rest; up to three exchanges. A moving axis would lose its position."""
        if self.read(Parameter.ACTUAL_VELOCITY) != 0:
            raise DeviceError(self.name, "set its counter", "the axis is moving", "stop it first")
        self.write(Parameter.ACTUAL_POSITION, microsteps)
        if self.settings.encoder:
            self.write(Parameter.ENCODER_POSITION, self.settings.encoder_value(microsteps))

    def switches(self) -> Switches:
        """Limit switches and home switch as the module reads them; three exchanges."""
        right, left, home = (
            bool(self.read(each)) for each in (Parameter.RIGHT_SWITCH, Parameter.LEFT_SWITCH, Parameter.HOME_SWITCH)
        )
        return Switches(right, left, home)

    def error_flags(self) -> ErrorFlag:
        """Stall and deviation flags. The module clears them when they are read."""
        return ErrorFlag(self.read(Parameter.ERROR_FLAGS) & 3)

    def driver_flags(self) -> DriverFlag:
        """Status flags of the motor driver (*)."""
        return DriverFlag(self.read(Parameter.DRIVER_FLAGS) & 0xFF)
