"""What a person gets to read when something that they gave us will not do."""


class UserError(Exception):
    """One line that names the thing, says what is wrong with it, and what to do. The command ends with status 2."""
