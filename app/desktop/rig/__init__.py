"""The rig screen: devices and axes."""
