"""Monitor: the monitor photodiode behind a SCPI picoammeter on USB.

`Monitor` is the instrument, `MonitorMean` a mean in progress. Each family of instruments is a `Dialect`.
"""

from goniotwin.drivers.monitor.monitor import DIALECTS, Dialect, Monitor, MonitorDescription, MonitorMean, MonitorSettings

__all__ = ["DIALECTS", "Dialect", "Monitor", "MonitorDescription", "MonitorMean", "MonitorSettings"]
