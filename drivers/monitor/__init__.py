"""Monitor: the monitor photodiode behind a SCPI picoammeter on USB.

`Monitor` is the instrument, `MonitorMean` a mean in progress. Each family of instruments is a `Dialect`.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.drivers.monitor.monitor import DIALECTS as DIALECTS
    from goniotwin.drivers.monitor.monitor import Dialect as Dialect
    from goniotwin.drivers.monitor.monitor import Monitor as Monitor
    from goniotwin.drivers.monitor.monitor import MonitorMean as MonitorMean
    from goniotwin.drivers.monitor.settings import MonitorDescription as MonitorDescription
    from goniotwin.drivers.monitor.settings import MonitorSettings as MonitorSettings
else:
    __getattr__ = first_use(
        __name__,
        {
            "monitor": ("DIALECTS", "Dialect", "Monitor", "MonitorMean"),
            "settings": ("MonitorDescription", "MonitorSettings"),
        },
    )
