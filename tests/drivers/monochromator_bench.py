"""A monochromator's driver, the unit behind it, and a wire between them that may fail."""

from dataclasses import replace

from goniotwin.drivers import wait
from goniotwin.mocks.faults import Misfortune, Script
from goniotwin.mocks.faulty_line import FaultyLine, plug_in
from goniotwin.twin.devices import Cornerstone260
from tests.conftest import RigOpener

DIALECTS = [(echo, handshake) for echo in (True, False) for handshake in (True, False)]


class Bench:
    """In one of the DIALECTS: with and without echo, with and without handshake mode."""

    def __init__(self, opened: RigOpener, echo: bool = True, handshake: bool = True) -> None:
        rig = opened()
        assert rig.virtual is not None
        self.plant, self.clock = rig.virtual.plant, rig.rig.clock
        drive = replace(self.plant.model.monochromator, echo=echo, handshake=handshake)
        self.plant.model = replace(self.plant.model, monochromator=drive)
        self.unit = Cornerstone260(self.plant)
        self.line = FaultyLine(self.unit, Script([]))
        ports = rig.virtual.serial
        plug_in(self.line, self.clock, lambda end: ports.update(mono=end))
        self.driver = rig.rig.monochromator
        self.driver.connect()

    def misfortune(self, misfortune: Misfortune, late_s: float = 0.1) -> None:
        self.line.misfortune, self.line._late_s = misfortune, late_s

    def light_nm(self) -> float:
        return self.plant.wavelength_nm.at(self.clock.now())

    def go(self, wavelength_nm: float) -> None:
        wait(self.clock, [self.driver.start_wavelength(wavelength_nm)])
