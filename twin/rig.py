"""Virtual rig: one plant, the devices that share it, their clock and their addresses."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock, VirtualClock
from goniotwin.twin.addresses import AXES, CONVERTER, CONVERTER_LINE, MONITOR, MONOCHROMATOR
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


@dataclass
class VirtualRig:
    """Devices by bus and address. The address is the second part of `twin://NAME/ADDRESS`."""

    plant: Plant
    clock: Clock
    serial: dict[str, SerialDevice] = field(default_factory=dict)
    modbus: dict[str, ConverterModule] = field(default_factory=dict)
    usb: dict[str, UsbTmcDevice] = field(default_factory=dict)
    lock: threading.RLock = field(default_factory=threading.RLock)
    """Held while bytes are brought to a device: all devices share one plant."""
    kinds: dict[str, str] = field(default_factory=dict)
    """By address: the make of the device, as the model names it."""
    modbus_wires: dict[str, Callable[[SerialDevice], SerialDevice]] = field(default_factory=dict)
    """By name of a Modbus TCP device: wrapper of the device's end of each new connection, before the in-process door."""

    @classmethod
    def build(cls, model: TwinModel, clock: Clock) -> "VirtualRig":
        """Build the rig of a model.

        Addresses are `axes`, `mono`, `adc-0` and so on, and `monitor`; with an RTU line of converters also `adcs`. Further
        devices of the model have their own addresses. On a clock of
        real time, at any speed, the kernels are compiled here, so that the first answers are as fast as all others.
        """
        plant = Plant(model)
        if not isinstance(clock, VirtualClock):
            plant.warm_up()
        rig = cls(plant, clock)
        if model.controller_axes or not model.devices:
            rig._add(AXES, TmclLine(plant), model.controller.kind)
        rig._add(MONOCHROMATOR, Cornerstone260(plant), "cornerstone")
        electronics = model.electronics
        if adam.MODELS[electronics.module].serial:
            modules: list[ConverterModule] = [Adam4117(plant, index, unit=index + 1) for index in range(plant.modules)]
            rig._add(CONVERTER_LINE, RtuStation(modules, electronics.baudrate), electronics.module)
        else:
            modules = [Adam6017(plant, index) for index in range(plant.modules)]
        for index, module in enumerate(modules):
            rig._add(CONVERTER.format(index), module, electronics.module)
        rig._add(MONITOR, UsbTmcDevice(Pm100d(plant), model.monitor.latency_s), "pm100d")
        for address, further in model.devices.items():
            rig._add(address, further.build(plant), further.kind)
        return rig

    def _add(self, address: str, device: SerialDevice | ConverterModule | UsbTmcDevice, kind: str) -> None:
        """Add a device of a make at an address, or replace the one there."""
        self.kinds[address] = kind
        buses: list[dict[str, Any]] = [self.usb, self.modbus, self.serial]
        bus = buses.pop(0 if isinstance(device, UsbTmcDevice) else 1 if isinstance(device, ConverterModule) else 2)
        bus[address] = device
        for other in buses:
            other.pop(address, None)

    def mount(self, sample: str | None) -> None:
        """Mount a sample now (simulation control). Raises KeyError for a sample that is not in the model."""
        self.plant.mount(sample, self.clock.now())
