"""The work of the commands, loaded when a command runs: a file for each command, or for some that load the same."""
