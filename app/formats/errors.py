"""The one error of this package: a file that cannot be read or written, in one line that a person can act on."""

import os

StrPath = str | os.PathLike[str]
LONGEST_WORD = 40


class FormatError(ValueError):
    """A file that is not what it should be.

    The message is one printable line: the file, the line in it where known, what is wrong and what to do.
    """

    def __init__(self, path: StrPath, wrong: str, remedy: str, line: int | None = None) -> None:
        super().__init__(path, wrong, remedy, line)
        self.path = os.fspath(path)
        self.wrong = wrong
        self.remedy = remedy
        self.line = line

    def __str__(self) -> str:
        where = self.path if self.line is None else f"{self.path}, line {self.line}"
        message = f"{where}: {self.wrong}; {self.remedy}"
        return "".join(letter if letter.isprintable() else "?" for letter in message)


def shown(word: str) -> str:
    """A word of a file as a message quotes it: short, and with nothing that a terminal would obey."""
    return ascii(word if len(word) <= LONGEST_WORD else word[:LONGEST_WORD] + "...")
