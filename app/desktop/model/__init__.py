"""The window's model: the rig's thread and its messages, the scan in progress, what may be done now. No Qt."""
