"""The window's model: the connection to the station and its messages, the values of a run, what is permitted now. No Qt."""
