"""The set-up screen: rig file, schedule, folder of data files."""
