"""A Thorlabs PM100D with a photodiode: current and power, ranges, averaging, wavelength, dark zero.

Source: Thorlabs, PM100D operation manual, "SCPI commands". To be confirmed on hardware: ranges, 3000 samples a second,
the bits of the status groups, the sensor's curve, how long a zero takes and from which current on it is refused. The
low-pass filter is a setting that changes nothing here.
"""

import math
from collections.abc import Iterator
from functools import partial
from itertools import pairwise

from goniotwin.protocols.scpi import NOT_A_NUMBER, OVERRANGE, MessageUnit, ScpiError, encode_number, suffixes
from goniotwin.twin.devices.scpi_instrument import Command, ScpiInstrument, bare, limit, number, single, switch
from goniotwin.twin.plant import Plant

RANGES_A = (50e-9, 500e-9, 5e-6, 50e-6, 500e-6, 5e-3)
OVER = 1.05
WAVELENGTHS_NM = (400.0, 1100.0)
SENSOR_A_PER_W = ((400.0, 0.02), (500.0, 0.06), (600.0, 0.1), (700.0, 0.14), (900.0, 0.2), (1000.0, 0.18), (1100.0, 0.05))
MAX_AVERAGES = 10_000
ZERO_S = 1.0
BRIGHTEST_ZERO_A = 50e-9
CALIBRATING, MEASURING = 0, 4  # bits of STATus:OPERation
OVER_CURRENT, OVER_POWER, ZEROED_BADLY = 1, 3, 8  # bits of STATus:QUEStionable
CURRENT, POWER = "CURR", "POW"
AMPERES, WATTS, NANOMETRES = suffixes("A"), suffixes("W"), {"NM": 1.0, "UM": 1e3, "M": 1e9}


class Pm100d(ScpiInstrument):
    """The instrument behind its USB interface."""

    manufacturer = "Thorlabs"
    product = "PM100D"
    vendor_id = 0x1313
    product_id = 0x8078
    firmware = "2.8.0"
    group_names = ("OPERation", "QUEStionable", "MEASurement", "AUXillary")

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._monitor = plant.model.monitor
        self.serial_number = self._monitor.serial_number
        self._zero_a = 0.0
        super().__init__()

    def preset(self) -> None:
        """*RST; the dark zero stays."""
        self._quantity = POWER
        self._range_a = RANGES_A[-1]
        self._auto = True
        self._averages = 1
        self._wavelength_nm = 635.0
        self._responsivity = _sensor(self._wavelength_nm)
        self._loss_db = 0.0
        self._beam_mm = 9.5
        self._dbm = False
        self._low_pass = False
        self.abort()

    def abort(self) -> None:
        """Stop a measurement and a zero adjustment."""
        self._measured: tuple[float, float] | None = None  # value, when it is ready
        self._zeroing: tuple[float, float] | None = None  # from, until

    def trigger(self) -> None:
        """Same as INITiate."""
        self._initiate()

    def pending_until(self) -> float:
        """The end of the measurement and of the zero."""
        ends = [pending[1] for pending in (self._measured, self._zeroing) if pending is not None]
        return max(ends, default=float("-inf"))

    def refresh(self, t: float) -> None:
        """End a zero that is over; update the status groups."""
        if self._zeroing is not None and self._zeroing[1] <= t:
            self._end_zero(*self._zeroing)
        operation = self.groups["OPERation"]
        operation.set(CALIBRATING, self._zeroing is not None)
        operation.set(MEASURING, self._measured is not None and self._measured[1] > t)

    def commands(self) -> Iterator[Command]:
        """Measuring, and everything under SENSe and INPut."""
        for quantity, pattern in ((CURRENT, "CURRent[:DC]"), (POWER, "POWer")):
            yield f"CONFigure[:SCALar]:{pattern}", False, bare(partial(self._configure, quantity))
            yield f"MEASure[:SCALar]:{pattern}", True, bare(partial(self._measure, quantity))
        yield "CONFigure[:SCALar]:VOLTage[:DC]", False, bare(_no_hardware)
        yield "MEASure[:SCALar]:VOLTage[:DC]", True, bare(_no_hardware)
        yield "CONFigure", True, bare(lambda: self._quantity.encode("ascii"))
        yield "INITiate[:IMMediate]", False, bare(self._initiate)
        yield "FETCh", True, bare(self._fetch)
        yield "READ", True, bare(self._read)
        yield "ABORt", False, bare(self.abort)
        yield "SYSTem:SENSor:IDN", True, bare(lambda: b"S120VC,TWIN,virtual photodiode,1,1,33")
        yield "INPut[:PDIode]:FILTer[:LPASs][:STATe]", False, self._set_low_pass
        yield "INPut[:PDIode]:FILTer[:LPASs][:STATe]", True, bare(lambda: b"%d" % self._low_pass)
        yield from self._sensing()
        yield from self._correcting()

    def _sensing(self) -> Iterator[Command]:
        yield "[SENSe]:AVERage[:COUNt]", False, self._set_averages
        yield "[SENSe]:AVERage[:COUNt]", True, lambda u: b"%d" % limit(u, 1, MAX_AVERAGES, 1, self._averages)
        yield "[SENSe]:CURRent[:DC]:RANGe[:UPPer]", False, self._set_range
        yield "[SENSe]:CURRent[:DC]:RANGe[:UPPer]", True, lambda u: encode_number(limit(u, *_ends(1.0), self._range_a))
        yield "[SENSe]:POWer[:DC]:RANGe[:UPPer]", False, self._set_power_range
        yield (
            "[SENSe]:POWer[:DC]:RANGe[:UPPer]",
            True,
            lambda u: encode_number(limit(u, *_ends(self._watts_per_ampere), self._range_a * self._watts_per_ampere)),
        )
        for quantity in ("CURRent[:DC]", "POWer[:DC]"):
            yield f"[SENSe]:{quantity}:RANGe:AUTO", False, self._set_auto
            yield f"[SENSe]:{quantity}:RANGe:AUTO", True, bare(lambda: b"%d" % self._auto)
        yield "[SENSe]:POWer[:DC]:UNIT", False, self._set_unit
        yield "[SENSe]:POWer[:DC]:UNIT", True, bare(lambda: b"DBM" if self._dbm else b"W")

    def _correcting(self) -> Iterator[Command]:
        correction = "[SENSe]:CORRection"
        ends = (*WAVELENGTHS_NM, 635.0)
        yield f"{correction}:WAVelength", False, self._set_wavelength
        yield f"{correction}:WAVelength", True, lambda u: encode_number(limit(u, *ends, self._wavelength_nm))
        yield f"{correction}:COLLect:ZERO[:INITiate]", False, bare(self._start_zero)
        yield f"{correction}:COLLect:ZERO:ABORt", False, bare(self._abort_zero)
        yield f"{correction}:COLLect:ZERO:STATe", True, bare(lambda: b"%d" % (self._zeroing is not None))
        yield f"{correction}:COLLect:ZERO:MAGNitude", True, bare(lambda: encode_number(self._zero_a))
        responsivity = f"{correction}:POWer[:PDIode][:RESPonse]"
        yield responsivity, False, self._set_responsivity
        yield responsivity, True, self._ask_responsivity
        loss = f"{correction}[:LOSS][:INPut][:MAGNitude]"
        yield loss, False, self._set_loss
        yield loss, True, lambda u: encode_number(limit(u, -60.0, 60.0, 0.0, self._loss_db))
        yield f"{correction}:BEAMdiameter", False, self._set_beam
        yield f"{correction}:BEAMdiameter", True, lambda u: encode_number(limit(u, 0.1, 100.0, 9.5, self._beam_mm))

    # ---- measuring ----

    def _configure(self, quantity: str) -> None:
        self._quantity = quantity
        self._measured = None

    def _measure(self, quantity: str) -> bytes:
        self._configure(quantity)
        return self._read()

    def _initiate(self) -> None:
        """Start averaging; the value is available when the averaging ends."""
        end = self._now + self._averages / self._monitor.samples_per_s
        current = self._plant.monitor_a(self._now, end)
        if self._auto:
            self._range_a = next((upper for upper in RANGES_A if abs(current) <= upper), RANGES_A[-1])
        over = abs(current) > OVER * self._range_a
        questionable = self.groups["QUEStionable"]
        questionable.set(OVER_CURRENT, over and self._quantity == CURRENT)
        questionable.set(OVER_POWER, over and self._quantity == POWER)
        self._measured = (OVERRANGE if over else self._shown(current - self._zero_a), end)

    def _shown(self, current_a: float) -> float:
        if self._quantity == CURRENT:
            return current_a
        watts = current_a * self._watts_per_ampere
        if not self._dbm:
            return watts
        return 10.0 * math.log10(watts / 1e-3) if watts > 0.0 else NOT_A_NUMBER

    @property
    def _watts_per_ampere(self) -> float:
        return float(10.0 ** (self._loss_db / 10.0)) / self._responsivity

    def _fetch(self) -> bytes:
        if self._measured is None:
            raise ScpiError(-230, "Data corrupt or stale")
        value, ready = self._measured
        self._now = max(self._now, ready)
        return encode_number(value)

    def _read(self) -> bytes:
        self._initiate()
        return self._fetch()

    def _start_zero(self) -> None:
        self._zeroing = (self._now, self._now + ZERO_S)

    def _abort_zero(self) -> None:
        self._zeroing = None

    def _end_zero(self, start: float, end: float) -> None:
        self._zeroing = None
        dark = self._plant.monitor_a(start, end)
        bad = abs(dark) > BRIGHTEST_ZERO_A
        self.groups["QUEStionable"].set(ZEROED_BADLY, bad)
        if bad:
            self.report(-200, "Execution error; too much light for a zero")
        else:
            self._zero_a = dark

    # ---- settings ----

    def _set_averages(self, unit: MessageUnit) -> None:
        self._averages = round(number(unit, 1, MAX_AVERAGES, 1, {}))

    def _set_range(self, unit: MessageUnit) -> None:
        self._choose_range(number(unit, *_ends(1.0), AMPERES))

    def _set_power_range(self, unit: MessageUnit) -> None:
        self._choose_range(number(unit, *_ends(self._watts_per_ampere), WATTS) / self._watts_per_ampere)

    def _choose_range(self, wanted_a: float) -> None:
        self._range_a = next((upper for upper in RANGES_A if wanted_a <= upper * (1.0 + 1e-9)), RANGES_A[-1])
        self._auto = False

    def _set_auto(self, unit: MessageUnit) -> None:
        self._auto = switch(unit)

    def _set_unit(self, unit: MessageUnit) -> None:
        if single(unit).upper() not in ("W", "DBM"):
            raise ScpiError(-224, "Illegal parameter value")
        self._dbm = single(unit).upper() == "DBM"

    def _set_low_pass(self, unit: MessageUnit) -> None:
        self._low_pass = switch(unit)

    def _set_wavelength(self, unit: MessageUnit) -> None:
        self._wavelength_nm = number(unit, *WAVELENGTHS_NM, 635.0, NANOMETRES)
        self._responsivity = _sensor(self._wavelength_nm)

    def _set_responsivity(self, unit: MessageUnit) -> None:
        self._responsivity = number(unit, 1e-6, 10.0, _sensor(self._wavelength_nm), {"A/W": 1.0, "A": 1.0})

    def _ask_responsivity(self, unit: MessageUnit) -> bytes:
        return encode_number(limit(unit, 1e-6, 10.0, _sensor(self._wavelength_nm), self._responsivity))

    def _set_loss(self, unit: MessageUnit) -> None:
        self._loss_db = number(unit, -60.0, 60.0, 0.0, {"DB": 1.0})

    def _set_beam(self, unit: MessageUnit) -> None:
        self._beam_mm = number(unit, 0.1, 100.0, 9.5, {"MM": 1.0, "M": 1e3})


def _ends(factor: float) -> tuple[float, float, float]:
    """Smallest and largest range, and the default."""
    return RANGES_A[0] * factor, RANGES_A[-1] * factor, RANGES_A[-1] * factor


def _sensor(wavelength_nm: float) -> float:
    """The sensor's responsivity, A/W, on the lines between the points of its curve."""
    for (low, at_low), (high, at_high) in pairwise(SENSOR_A_PER_W):
        if wavelength_nm <= high:
            return at_low + (at_high - at_low) * (wavelength_nm - low) / (high - low)
    return SENSOR_A_PER_W[-1][1]


def _no_hardware() -> bytes:
    raise ScpiError(-241, "Hardware missing; no voltage sensor")
