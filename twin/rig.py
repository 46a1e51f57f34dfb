"""A virtual rig: one plant, the devices that share it, the clock they live by, and the addresses they are found at."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from goniotwin.protocols.clock import Clock, RealClock
from goniotwin.twin.devices import (
    Adam4117,
    Adam6017,
    ConverterModule,
    Cornerstone260,
    Pm100d,
    RtuStation,
    TmclLine,
    UsbTmcDevice,
)
from goniotwin.twin.devices.line import SerialDevice
from goniotwin.twin.plant import Plant, TwinModel

AXES, MONOCHROMATOR, MONITOR = "axes", "mono", "monitor"
CONVERTER = "adc-{}"
CONVERTER_LINE = "adcs"


@dataclass
class VirtualRig:
    """Devices by their addresses, the second part of `twin://NAME/ADDRESS`, sorted by bus."""

    plant: Plant
    clock: Clock
    serial: dict[str, SerialDevice] = field(default_factory=dict)
    modbus: dict[str, ConverterModule] = field(default_factory=dict)
    usb: dict[str, UsbTmcDevice] = field(default_factory=dict)
    lock: threading.RLock = field(default_factory=threading.RLock)
    """Held by whoever brings bytes to a device: all of them share one plant."""
    modbus_wires: dict[str, Callable[[SerialDevice], SerialDevice]] = field(default_factory=dict)
    """By a Modbus TCP device's name: what is put between its end of each new connection and the in-process door."""

    @classmethod
    def build(cls, model: TwinModel, clock: Clock) -> "VirtualRig":
        """The rig of a model: `axes`, `mono`, `adc-0` and so on, `monitor`; with an RTU line of converters also `adcs`.

        On a real clock its first answers are as fast as all others: what has to be compiled is compiled here.
        """
        plant = Plant(model)
        if isinstance(clock, RealClock):
            plant.warm_up()
        rig = cls(plant, clock)
        rig.serial[AXES] = TmclLine(plant)
        rig.serial[MONOCHROMATOR] = Cornerstone260(plant)
        electronics = model.electronics
        if electronics.module == "adam-4117":
            modules = [Adam4117(plant, index, unit=index + 1) for index in range(plant.modules)]
            rig.modbus = {CONVERTER.format(index): module for index, module in enumerate(modules)}
            rig.serial[CONVERTER_LINE] = RtuStation([*modules], electronics.baudrate)
        else:
            rig.modbus = {CONVERTER.format(index): Adam6017(plant, index) for index in range(plant.modules)}
        rig.usb[MONITOR] = UsbTmcDevice(Pm100d(plant), model.monitor.latency_s)
        return rig

    def mount(self, sample: str | None) -> None:
        """The back door of the sample unit, now. Raises KeyError for a sample that the model does not have."""
        self.plant.mount(sample, self.clock.now())
