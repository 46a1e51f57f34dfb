"""The window's model: the rig's thread and its messages, the scan in progress, what is permitted now. No Qt."""
