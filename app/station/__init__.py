"""The station: the process that holds a rig from Connect to Disconnect. Windows and terminals are its clients.

`Station` is a plain object with the commands. Its `Poller` reports what an open rig does while no run has it, `Runs` begins and
measures campaigns, `Questions` are those to the operator of a run, `SafetyOrders` those to a person, and `Stops` what is
refused while the axes are brought to rest. `StationServer` and `StationClient` are the two ends of its channel;
`connection_file` has how a client finds it, `process` how it is started and ended. No Qt, nothing of the window.
"""
