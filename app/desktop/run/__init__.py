"""The run screen: start, pause, stop, progress, and the live plot."""
