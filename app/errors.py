"""The error that the user of a command sees, and the remedy for a full disk."""

import errno

FULL_DISK = frozenset({errno.ENOSPC, errno.EDQUOT})


class UserError(Exception):
    """User-facing error: one line that names the file, option or device, the fault and the remedy; no traceback.

    The command ends with `status`.
    """

    status = 2


def room_on_disk(error: OSError) -> str:
    """The remedy for a file that cannot be written because the disk, or the user's part of it, is full; else empty."""
    return "free space on the disk" if error.errno in FULL_DISK else ""
