"""How a schedule has its rows measured: averaging, warm-up, drift checks, what ends a run, what is done about faults, and
the etalon's certificate. Each is a table of the schedule file that may be left out."""

from datetime import date
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt

from goniotwin.app.toml_file import TomlTable

Share = Annotated[float, Field(gt=0.0, lt=1.0)]
Policy = Literal["retry", "reconnect", "skip", "ask", "stop"]


class AveragingTable(TomlTable):
    """Each row is read on, at each of its gains, until every photodiode that has light knows it to `relative_uncertainty`
    (standard, of noise alone), or for `longest_s`. The schedule's `readings` are then the fewest.
    """

    relative_uncertainty: Share
    longest_s: PositiveFloat = 10.0


class WarmUpTable(TomlTable):
    """The campaign begins with a wait for the lamp, with open shutter: until the monitor changes by no more than
    `percent_per_10min`, or for `longest_s`.
    """

    percent_per_10min: PositiveFloat
    longest_s: PositiveFloat = 3600.0


class DriftTable(TomlTable):
    """Every `every_s` the light at one pose is measured again. Where it, over the monitor's, is another than it was at first
    by more than `limit` (a share), the rows between the checks are flagged, or the run stops as well.
    """

    every_s: PositiveFloat
    sigma_deg: float
    beta_deg: float
    shift_deg: float = 0.0
    gamma_deg: float = 0.0
    wavelength_nm: PositiveFloat
    limit: Share = 0.005
    on_excess: Literal["flag", "stop"] = "flag"


class StopTable(TomlTable):
    """What ends a run before its last row, in good order: it can be gone on with.

    `longest_s` is of the rig's time in one session; `skipped_rows` how many rows of a session may be skipped for faults;
    `lamp_below` the share to which the monitor's current may fall of what it was at first at that wavelength.
    """

    longest_s: PositiveFloat | None = None
    skipped_rows: PositiveInt | None = None
    lamp_below: Share | None = None


class FaultsTable(TomlTable):
    """What is done where a device fails in a row, by the kind of fault; without this table the run stops safely.

    `wire`: no answer, or a wrong one. `reset`: a device has lost its settings. `refused`: it will not, or cannot. `axis`: it is
    in doubt where an axis is, or it did not arrive. The policies: `retry`: the row again, after `wait_s`. `reconnect`: the
    devices are connected again, axes in doubt are homed, and the row is done again. `skip`: the row is left out and flagged.
    `ask`: somebody is asked to mend it. `stop`. A row is begun `attempts` times at most; `then` is what follows.
    """

    wire: Policy = "reconnect"
    reset: Policy = "reconnect"
    refused: Policy = "retry"
    axis: Policy = "stop"
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    wait_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 1.0
    then: Literal["skip", "ask", "stop"] = "stop"


class CertificateTable(TomlTable):
    """The etalon's certificate, in place of the rig file's `[etalon]`: a CSV `file` beside the schedule, which holds until
    the end of the day `expires`. `accept_expired_by` is the name of who answers for using it after that.
    """

    file: Annotated[str, Field(min_length=1)]
    expires: date
    accept_expired_by: Annotated[str, Field(min_length=1)] | None = None
