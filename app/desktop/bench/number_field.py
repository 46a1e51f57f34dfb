"""A field for a number that is what was typed, or refused: with a decimal point or comma, and no character ignored."""

import re

from PySide6.QtCore import Signal, Slot
from PySide6.QtGui import QValidator
from PySide6.QtWidgets import QDoubleSpinBox

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")


class NumberField(QDoubleSpinBox):
    """A number between limits, of so many decimals. `refused` has the reason where what was typed is none; the field then has
    the number before. `typed` has each text that is a number, while it is typed.
    """

    refused = Signal(str)
    typed = Signal(float)

    def __init__(self, name: str, lowest: float, highest: float, decimals: int) -> None:
        super().__init__()
        self._wrong = False
        self.setRange(lowest, highest)
        self.setDecimals(decimals)
        self.setKeyboardTracking(False)  # else the first characters of what is refused would stay
        self._name = name
        for each in (self, self.lineEdit()):
            each.setAccessibleName(name)
        self.lineEdit().textEdited.connect(self._note_text)
        self.valueChanged.connect(self._note_value)

    def entered(self) -> float | None:
        """The number in the field; None, once, where what was typed was refused."""
        self.interpretText()
        wrong, self._wrong = self._wrong, False
        return None if wrong else self.value()

    def validate(self, text: str, position: int) -> tuple[QValidator.State, str, int]:
        """Let everything be typed; Qt calls it."""
        known = self._number(text) is not None
        return (QValidator.State.Acceptable if known else QValidator.State.Intermediate), text, position

    def valueFromText(self, text: str) -> float:
        """The number of a text; Qt calls it for one that is valid."""
        number = self._number(text)
        return self.value() if number is None else number

    def fixup(self, text: str) -> str:
        """Refuse a text; Qt calls it, and restores the number before."""
        self._wrong = True
        given = self._bare(text)
        decimals = f" with at most {self.decimals()} decimals" if self.decimals() else ", whole"
        limits = f"{self.minimum():g} to {self.maximum():g}"
        self.refused.emit(f"{self._name}: {given or 'nothing'}: give a number from {limits}{decimals}")
        return text

    def _bare(self, text: str) -> str:
        return text.removeprefix(self.prefix()).removesuffix(self.suffix()).strip()

    def _number(self, text: str) -> float | None:
        number = number_of(self._bare(text), self.decimals())
        return number if number is not None and self.minimum() <= number <= self.maximum() else None

    @Slot(str)
    def _note_text(self, text: str) -> None:
        self._wrong = False
        if (number := self._number(text)) is not None:
            self.typed.emit(number)

    @Slot()
    def _note_value(self) -> None:
        self._wrong = False


def number_of(text: str, decimals: int) -> float | None:
    """The number of a text, with a decimal point or comma; None for another text, or more decimals."""
    bare = text.strip().replace("−", "-").replace(",", ".")
    if NUMBER.fullmatch(bare) is None or len(bare.partition(".")[2].rstrip("0")) > decimals:
        return None
    return float(bare)
