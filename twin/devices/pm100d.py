"""A Thorlabs PM100D with a photodiode: current, power and its density, ranges, averaging, wavelength, dark zero, delta mode.

Source: Thorlabs, PM100D operation manual, "SCPI commands"; what of it was seen, and what is assumed, stands in
docs/rig/interoperability.md. To be confirmed on hardware: ranges, 3000 samples a second, the sensor's curve, how long a zero
takes and from which current on it is refused, the bit that it sets, the limits of references and threshold.

Settings without an effect here: low-pass filter, line frequency, type of the adapter (for a sensor without memory), beeper
and display. The instrument's calendar begins at 2000-01-01 with the rig, until it is set.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from functools import partial
from itertools import pairwise
from typing import NamedTuple

from goniotwin.protocols.scpi import NOT_A_NUMBER, OVERRANGE, MessageUnit, ScpiError, encode_number, suffixes, words
from goniotwin.twin.devices.scpi_instrument import Command, ScpiInstrument, bare, limit, number, single, switch
from goniotwin.twin.plant import Plant


class Ends(NamedTuple):
    """Limits of a setting and its default, which MIN, MAX and DEF stand for."""

    lowest: float
    highest: float
    default: float


RANGES_A = (50e-9, 500e-9, 5e-6, 50e-6, 500e-6, 5e-3)
OVER = 1.05
WAVELENGTHS_NM = Ends(200.0, 1100.0, 635.0)
SENSOR_A_PER_W = (
    (200.0, 0.01), (400.0, 0.02), (500.0, 0.06), (600.0, 0.1), (700.0, 0.14), (900.0, 0.2), (1000.0, 0.18), (1100.0, 0.05),
)  # fmt: skip
MAX_AVERAGES = 10_000
ZERO_S = 1.0
BRIGHTEST_ZERO_A = 50e-9
CALIBRATING, MEASURING = 0, 4  # bits of STATus:OPERation
OVER_CURRENT, OVER_POWER, ZEROED_BADLY = 1, 3, 8  # bits of STATus:QUEStionable
CURRENT, POWER, DENSITY, FREQUENCY, TEMPERATURE = "CURR", "POW", "PDEN", "FREQ", "TEMP"
MEASURABLE = {
    CURRENT: "CURRent[:DC]",
    POWER: "[POWer]",
    DENSITY: "PDENsity",
    FREQUENCY: "FREQuency",
    TEMPERATURE: "TEMPerature",
}
OTHER_SENSORS = ("VOLTage[:DC]", "ENERgy", "EDENsity")
"""What thermopiles and pyroelectric sensors measure, and a photodiode does not."""
ADAPTERS = ("PHOTodiode", "THERmal", "PYRo")
AMPERES, WATTS, NANOMETRES = suffixes("A"), suffixes("W"), {"NM": 1.0, "UM": 1e3, "M": 1e9}
NO_UNIT: Mapping[str, float] = {}
DECIBELS, MILLIMETRES, PERCENT = {"DB": 1.0}, {"MM": 1.0, "M": 1e3}, {"PCT": 1.0, "%": 1.0}
LOSS_DB, BEAM_MM, THRESHOLD_PERCENT = Ends(-60.0, 60.0, 0.0), Ends(0.1, 100.0, 9.5), Ends(0.0, 100.0, 20.0)
DISPLAY = Ends(0.0, 1.0, 0.5)
LINE_HZ = Ends(50.0, 60.0, 50.0)
GATE_S = 0.5
"""Time in which a frequency is counted."""
CALENDAR, YEARS = datetime(2000, 1, 1), (2000, 2099)
KELVIN = 273.15


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
        self._beeper = True
        self._brightness = self._contrast = DISPLAY.default
        self._line_hz = LINE_HZ.default
        self._adapter = ADAPTERS[0]
        self._calendar = CALENDAR
        super().__init__()

    def preset(self) -> None:
        """*RST; the dark zero, and what belongs to the console, stay."""
        self._quantity = POWER
        self._range_a = RANGES_A[-1]
        self._auto = True
        self._averages = 1
        self._wavelength_nm = WAVELENGTHS_NM.default
        self._responsivity = _sensor(self._wavelength_nm)
        self._loss_db = LOSS_DB.default
        self._beam_mm = BEAM_MM.default
        self._threshold_percent = THRESHOLD_PERCENT.default
        self._reference_a = self._reference_w = 0.0
        self._delta_current = self._delta_power = False
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
        """Measuring, and everything under SENSe, INPut, SYSTem, DISPlay and CALibration."""
        for quantity, pattern in MEASURABLE.items():
            yield f"CONFigure[:SCALar]:{pattern}", False, bare(partial(self._configure, quantity))
            yield f"MEASure[:SCALar]:{pattern}", True, bare(partial(self._measure, quantity))
        for pattern in OTHER_SENSORS:
            yield f"CONFigure[:SCALar]:{pattern}", False, bare(_no_hardware)
            yield f"MEASure[:SCALar]:{pattern}", True, bare(_no_hardware)
        yield "CONFigure", True, bare(lambda: self._quantity.encode("ascii"))
        yield "INITiate[:IMMediate]", False, bare(self._initiate)
        yield "FETCh", True, bare(self._fetch)
        yield "READ", True, bare(self._read)
        yield "ABORt", False, bare(self.abort)
        yield from self._switch("INPut[:PDIode]:FILTer[:LPASs][:STATe]", "_low_pass")
        yield "INPut:ADAPter[:TYPE]", False, self._set_adapter
        yield "INPut:ADAPter[:TYPE]", True, bare(lambda: words(self._adapter)[0].encode("ascii"))
        yield from self._console()
        yield from self._sensing()
        yield from self._correcting()

    def _console(self) -> Iterator[Command]:
        """What belongs to the console and not to a measurement."""
        yield "SYSTem:SENSor:IDN", True, bare(lambda: b"S120VC,TWIN,virtual photodiode,1,18,289")
        yield "CALibration:STRing", True, bare(lambda: b'"Calibrated: virtual instrument"')
        yield "SYSTem:BEEPer[:IMMediate]", False, bare(lambda: None)
        yield from self._switch("SYSTem:BEEPer:STATe", "_beeper")
        yield "SYSTem:LFRequency", False, self._set_line_frequency
        yield "SYSTem:LFRequency", True, lambda u: b"%d" % limit(u, *LINE_HZ, self._line_hz)
        yield "SYSTem:DATE", False, self._set_date
        yield "SYSTem:DATE", True, bare(lambda: "{0.year},{0.month},{0.day}".format(self._today()).encode("ascii"))
        yield "SYSTem:TIME", False, self._set_time
        yield "SYSTem:TIME", True, bare(lambda: "{0.hour},{0.minute},{0.second}".format(self._today()).encode("ascii"))
        yield from self._setting("DISPlay:BRIGhtness", "_brightness", lambda: DISPLAY)
        yield from self._setting("DISPlay:CONTrast", "_contrast", lambda: DISPLAY)

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
            yield from self._switch(f"[SENSe]:{quantity}:RANGe:AUTO", "_auto")
        yield "[SENSe]:POWer[:DC]:UNIT", False, self._set_unit
        yield "[SENSe]:POWer[:DC]:UNIT", True, bare(lambda: b"DBM" if self._dbm else b"W")
        yield from self._setting("[SENSe]:CURRent[:DC]:REFerence", "_reference_a", lambda: _around_zero(1.0), AMPERES)
        yield from self._switch("[SENSe]:CURRent[:DC]:REFerence:STATe", "_delta_current")
        yield from self._setting(
            "[SENSe]:POWer[:DC]:REFerence", "_reference_w", lambda: _around_zero(self._watts_per_ampere), WATTS
        )
        yield from self._switch("[SENSe]:POWer[:DC]:REFerence:STATe", "_delta_power")
        yield "[SENSe]:FREQuency:RANGe[:UPPer]", True, bare(lambda: encode_number(0.5 * self._monitor.samples_per_s))
        yield "[SENSe]:FREQuency:RANGe:LOWer", True, bare(lambda: encode_number(1.0 / GATE_S))
        threshold = "[SENSe]:PEAKdetector[:THReshold]"
        yield from self._setting(threshold, "_threshold_percent", lambda: THRESHOLD_PERCENT, PERCENT)

    def _correcting(self) -> Iterator[Command]:
        correction = "[SENSe]:CORRection"
        yield f"{correction}:WAVelength", False, self._set_wavelength
        yield f"{correction}:WAVelength", True, lambda u: encode_number(limit(u, *WAVELENGTHS_NM, self._wavelength_nm))
        yield f"{correction}:COLLect:ZERO[:INITiate]", False, bare(self._start_zero)
        yield f"{correction}:COLLect:ZERO:ABORt", False, bare(self._abort_zero)
        yield f"{correction}:COLLect:ZERO:STATe", True, bare(lambda: b"%d" % (self._zeroing is not None))
        yield f"{correction}:COLLect:ZERO:MAGNitude", True, bare(lambda: encode_number(self._zero_a))
        responsivity = f"{correction}:POWer[:PDIode][:RESPonse]"
        yield responsivity, False, self._set_responsivity
        yield responsivity, True, self._ask_responsivity
        yield from self._setting(f"{correction}[:LOSS][:INPut][:MAGNitude]", "_loss_db", lambda: LOSS_DB, DECIBELS)
        yield from self._setting(f"{correction}:BEAMdiameter", "_beam_mm", lambda: BEAM_MM, MILLIMETRES)

    def _setting(
        self, pattern: str, name: str, ends: Callable[[], Ends], factors: Mapping[str, float] = NO_UNIT
    ) -> Iterator[Command]:
        """A number in the attribute `name`, and its query."""

        def change(unit: MessageUnit) -> None:
            setattr(self, name, number(unit, *ends(), factors))

        yield pattern, False, change
        yield pattern, True, lambda unit: encode_number(limit(unit, *ends(), getattr(self, name)))

    def _switch(self, pattern: str, name: str) -> Iterator[Command]:
        """On or off in the attribute `name`, and its query."""
        yield pattern, False, lambda unit: setattr(self, name, switch(unit))
        yield pattern, True, bare(lambda: b"%d" % getattr(self, name))

    # ---- measuring ----

    def _configure(self, quantity: str) -> None:
        self._quantity = quantity
        self._measured = None

    def _measure(self, quantity: str) -> bytes:
        self._configure(quantity)
        return self._read()

    def _initiate(self) -> None:
        """Start averaging; the value is available when the averaging ends."""
        if self._quantity == TEMPERATURE:
            self._measured = (self._plant.model.electronics.temperature_k - KELVIN, self._now)
            return
        end = self._now + (GATE_S if self._quantity == FREQUENCY else self._averages / self._monitor.samples_per_s)
        current = self._plant.monitor_a(self._now, end)
        if self._auto:
            self._range_a = next((upper for upper in RANGES_A if abs(current) <= upper), RANGES_A[-1])
        if self._quantity == FREQUENCY:
            self._measured = (self._frequency_hz(self._now), end)
            return
        over = abs(current) > OVER * self._range_a
        questionable = self.groups["QUEStionable"]
        questionable.set(OVER_CURRENT, over and self._quantity == CURRENT)
        questionable.set(OVER_POWER, over and self._quantity != CURRENT)
        self._measured = (OVERRANGE if over else self._shown(current - self._zero_a), end)

    def _shown(self, current_a: float) -> float:
        if self._quantity == CURRENT:
            return current_a - (self._reference_a if self._delta_current else 0.0)
        watts = current_a * self._watts_per_ampere - (self._reference_w if self._delta_power else 0.0)
        if self._quantity == DENSITY:
            return watts / (math.pi * (0.05 * self._beam_mm) ** 2)  # W/cm2
        if not self._dbm:
            return watts
        return 10.0 * math.log10(watts / 1e-3) if watts > 0.0 else NOT_A_NUMBER

    def _frequency_hz(self, start: float) -> float:
        """Frequency at which the current rises through the threshold; 0 for one that does not do so twice in the gate time."""
        period = 1.0 / self._monitor.samples_per_s
        threshold = 0.01 * self._threshold_percent * self._range_a
        times = [start + k * period for k in range(round(GATE_S / period))]
        above = [self._plant.monitor_a(t, t + period) > threshold for t in times]
        rises = [t for t, (before, now) in zip(times[1:], pairwise(above), strict=True) if now and not before]
        return (len(rises) - 1) / (rises[-1] - rises[0]) if len(rises) > 1 else 0.0

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

    def _set_unit(self, unit: MessageUnit) -> None:
        if single(unit).upper() not in ("W", "DBM"):
            raise ScpiError(-224, "Illegal parameter value")
        self._dbm = single(unit).upper() == "DBM"

    def _set_wavelength(self, unit: MessageUnit) -> None:
        self._wavelength_nm = number(unit, *WAVELENGTHS_NM, NANOMETRES)
        self._responsivity = _sensor(self._wavelength_nm)

    def _set_responsivity(self, unit: MessageUnit) -> None:
        self._responsivity = number(unit, 1e-6, 10.0, _sensor(self._wavelength_nm), {"A/W": 1.0, "A": 1.0})

    def _ask_responsivity(self, unit: MessageUnit) -> bytes:
        return encode_number(limit(unit, 1e-6, 10.0, _sensor(self._wavelength_nm), self._responsivity))

    def _set_adapter(self, unit: MessageUnit) -> None:
        text = single(unit).upper()
        chosen = next((each for each in ADAPTERS if text in words(each)), None)
        if chosen is None:
            raise ScpiError(-224, "Illegal parameter value")
        self._adapter = chosen

    def _set_line_frequency(self, unit: MessageUnit) -> None:
        self._line_hz = 50.0 if number(unit, *LINE_HZ, suffixes("HZ")) < 55.0 else 60.0

    # ---- calendar ----

    def _today(self) -> datetime:
        return self._calendar + timedelta(seconds=self._now)

    def _set_date(self, unit: MessageUnit) -> None:
        year, month, day = _whole_numbers(unit, YEARS, (1, 12), (1, 31))
        try:
            wanted = date(year, month, day)
        except ValueError:
            raise ScpiError(-222, "Data out of range") from None
        self._calendar += wanted - self._today().date()

    def _set_time(self, unit: MessageUnit) -> None:
        hour, minute, second = _whole_numbers(unit, (0, 23), (0, 59), (0, 59))
        today = self._today()
        self._calendar += datetime.combine(today, time(hour, minute, second)) - today


def _ends(factor: float) -> Ends:
    """Smallest and largest range, and the default."""
    return Ends(RANGES_A[0] * factor, RANGES_A[-1] * factor, RANGES_A[-1] * factor)


def _around_zero(factor: float) -> Ends:
    """Limits of a reference: the largest range, to both sides."""
    return Ends(-RANGES_A[-1] * factor, RANGES_A[-1] * factor, 0.0)


def _whole_numbers(unit: MessageUnit, *ends: tuple[int, int]) -> list[int]:
    """The numbers of a command, between these limits. Raises ScpiError."""
    if len(unit.parameters) != len(ends):
        fewer = len(unit.parameters) < len(ends)
        raise ScpiError(-109, "Missing parameter") if fewer else ScpiError(-108, "Parameter not allowed")
    each = zip(unit.parameters, ends, strict=True)
    return [round(number(replace(unit, parameters=(text,)), low, high, low, {})) for text, (low, high) in each]


def _sensor(wavelength_nm: float) -> float:
    """The sensor's responsivity, A/W, on the lines between the points of its curve."""
    for (low, at_low), (high, at_high) in pairwise(SENSOR_A_PER_W):
        if wavelength_nm <= high:
            return at_low + (at_high - at_low) * (wavelength_nm - low) / (high - low)
    return SENSOR_A_PER_W[-1][1]


def _no_hardware() -> bytes:
    raise ScpiError(-241, "Hardware missing; the sensor is a photodiode")
