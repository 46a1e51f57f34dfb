"""The wires' grammars, spelled once for both sides of each wire, and the clock.

No I/O and no state: bytes to messages and messages to bytes. `clock` holds the Clock interface and its
two implementations, the only code that reads or waits for the time.
"""
