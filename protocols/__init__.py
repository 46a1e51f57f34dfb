"""The wires' grammars, spelled once for both sides of each wire, the clock, and the channel between programs.

A grammar has no I/O and no state: bytes to messages and messages to bytes. `clock` holds the Clock interface and its
two implementations, the only code that reads or waits for the time. `channel` is no wire of the instrument: both of its ends
are programs of ours.
"""
