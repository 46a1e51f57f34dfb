"""Monitor: the monitor photodiode behind a SCPI picoammeter on USB.

`Monitor` is the instrument, `MonitorMean` a mean in progress. Each family of instruments is a `Dialect`.
"""
