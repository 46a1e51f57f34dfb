"""The station: the process that holds a rig from Connect to Disconnect. Windows and terminals are its clients.

`Station` is a plain object with the commands; `StationServer` and `StationClient` are the two ends of its channel;
`connection_file` has how a client finds it, `process` how it is started and ended. No Qt, nothing of the window.
"""
