"""How instruments that measure a photodiode want to be told: a small table of SCPI strings for each family.

Another picoammeter with USBTMC and SCPI is a line here. To be confirmed on hardware: everything but the PM100D's spelling.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Dialect:
    """The strings; None for what the family does not have. `{}` takes a number.

    `averaging` takes a count of samples where `averages_samples`, else seconds. `before` is sent once at connect.
    """

    name: str
    current: str
    current_range: str
    averaging: str
    averages_samples: bool
    read: str = "READ?"
    auto_range: str = "SENS:CURR:RANG:AUTO {:d}"
    power: str | None = None
    power_unit: str | None = None
    wavelength: str | None = None
    low_pass: str | None = None
    zero: str | None = None
    zero_state: str | None = None
    zero_value: str | None = None
    before: tuple[str, ...] = ()


PM100D = Dialect(
    name="pm100d",
    current="CONF:CURR",
    current_range="SENS:CURR:RANG {:.1E}",
    averaging="SENS:AVER:COUN {:d}",
    averages_samples=True,
    power="CONF:POW",
    power_unit="SENS:POW:UNIT W",
    wavelength="SENS:CORR:WAV {:.3f}",
    low_pass="INP:PDI:FILT:LPAS:STAT {:d}",
    zero="SENS:CORR:COLL:ZERO:INIT",
    zero_state="SENS:CORR:COLL:ZERO:STAT?",
    zero_value="SENS:CORR:COLL:ZERO:MAGN?",
)
B2980 = Dialect(
    name="b2980",
    current="SENS:FUNC 'CURR'",
    current_range="SENS:CURR:RANG {:.1E}",
    averaging="SENS:CURR:APER {:.6E}",
    averages_samples=False,
    before=("FORM ASC", "FORM:ELEM:SENS CURR", "INP ON"),
)
DIALECTS = {each.name: each for each in (PM100D, B2980)}
