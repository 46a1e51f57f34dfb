"""Test bench: the monochromator driver, its virtual unit, and a wire with faults between them."""

from dataclasses import replace
from typing import Any

from goniotwin.drivers import wait
from goniotwin.mocks.faults import FaultPlan, ScriptedFaults
from goniotwin.mocks.faulty_line import FaultyLine, plug_in
from goniotwin.twin.devices import Cornerstone260
from tests.conftest import RigOpener

DIALECTS = [(echo, handshake) for echo in (True, False) for handshake in (True, False)]


class MonochromatorBench:
    """A monochromator in one of the DIALECTS: with or without echo, with or without handshake mode."""

    def __init__(self, opened: RigOpener, echo: bool = True, handshake: bool = True, **unit: Any) -> None:
        """`unit` has further settings of the virtual unit."""
        rig = opened()
        assert rig.virtual is not None
        self.plant, self.clock, self.wires = rig.virtual.plant, rig.rig.clock, rig.wires()
        drive = replace(self.plant.model.monochromator, echo=echo, handshake=handshake, **unit)
        self.plant.model = replace(self.plant.model, monochromator=drive)
        self.unit = Cornerstone260(self.plant)
        self.line = FaultyLine(self.unit, ScriptedFaults([]))
        ports = rig.virtual.serial
        plug_in(self.line, self.clock, lambda end: ports.update(mono=end))
        self.driver = rig.rig.monochromator
        self.driver.connect()

    def set_faults(self, misfortune: FaultPlan, late_s: float = 0.1) -> None:
        self.line.misfortune, self.line.late_s = misfortune, late_s

    def true_wavelength_nm(self) -> float:
        return self.plant.wavelength_nm.at(self.clock.now())

    def go(self, wavelength_nm: float) -> None:
        wait(self.clock, [self.driver.start_wavelength(wavelength_nm)])
