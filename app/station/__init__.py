"""The station: the process that holds a rig from Connect to Disconnect. Windows and terminals are its clients.

`Station` is a plain object with the commands. Its `Connector` connects the devices of a rig, its `Poller` reports what they do
while no run has them, and `Runs` begins and measures campaigns. `Questions` are those of a run to its operator, `SafetyOrders`
those to a person, and `Stops` refuses what would begin while the axes are brought to rest. `StationServer` and `StationClient`
are the two ends of its channel; `connection_file` has how a client finds it, `process` how it is started and ended. No Qt,
nothing of the window.
"""
