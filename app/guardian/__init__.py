"""The guardian: a small process that brings a rig into a safe state when the program that controlled it has died.

It knows no device and no protocol: it is handed last wills (`drivers.guard`) with an address, and carries them out when its
parent's end of a pipe closes without a farewell. `guard` is the parent's side, `__main__` the process. What that process
loads (`record`, `held`) is as light as it can be: the standard library, pyserial, and nothing else.
"""
