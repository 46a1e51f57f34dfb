"""A virtual rig: one plant, the devices that share it, the clock they live by, and the addresses they are found at."""

from dataclasses import dataclass, field

from protocols.clock import Clock
from twin.devices import Adam6017, Cornerstone260, Pm100d, Tmcm6214, UsbTmcDevice
from twin.devices.line import SerialDevice
from twin.plant import Plant, TwinModel

AXES, MONOCHROMATOR, MONITOR = "axes", "mono", "monitor"
CONVERTER = "adc-{}"


@dataclass
class VirtualRig:
    """Devices by their addresses, the second part of `twin://NAME/ADDRESS`, sorted by bus."""

    plant: Plant
    clock: Clock
    serial: dict[str, SerialDevice] = field(default_factory=dict)
    modbus: dict[str, Adam6017] = field(default_factory=dict)
    usb: dict[str, UsbTmcDevice] = field(default_factory=dict)

    @classmethod
    def build(cls, model: TwinModel, clock: Clock) -> "VirtualRig":
        """The rig of a model: `axes`, `mono`, `adc-0` and so on, `monitor`."""
        plant = Plant(model)
        rig = cls(plant, clock)
        rig.serial[AXES] = Tmcm6214(plant)
        rig.serial[MONOCHROMATOR] = Cornerstone260(plant)
        rig.modbus = {CONVERTER.format(index): Adam6017(plant, index) for index in range(plant.modules)}
        rig.usb[MONITOR] = UsbTmcDevice(Pm100d(plant), model.monitor.latency_s)
        return rig

    def mount(self, sample: str | None) -> None:
        """The back door of the sample unit, now. Raises KeyError for a sample that the model does not have."""
        self.plant.mount(sample, self.clock.now())
