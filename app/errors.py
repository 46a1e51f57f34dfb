"""The error that the user of a command sees."""


class UserError(Exception):
    """User-facing error: one line that names the file, option or device, the fault and the remedy; no traceback.

    The command ends with `status`.
    """

    status = 2
