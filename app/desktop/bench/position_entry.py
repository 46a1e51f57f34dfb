"""Where an axis is: its counter and its encoder side by side, and an empty field for what a person reads from its scale."""

from PySide6.QtCore import Qt, Slot
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QGridLayout, QLabel, QLineEdit, QPushButton, QWidget

from goniotwin.app.campaign.wording import ENCODER_LOST
from goniotwin.app.desktop.bench.number_field import number_of
from goniotwin.app.desktop.rig.panels import NO_VALUE

DECIMALS = 3
FROM_SCALE = "from its scale"
NO_ANGLE = "read the angle from the scale of the axis, and enter it in degrees"


class AnswerField(QLineEdit):
    """A field in which Enter gives no answer: the default of a question would be taken for what was typed."""

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Take a key; Qt calls it."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            event.accept()
        else:
            super().keyPressEvent(event)


class PositionEntry(QWidget):
    """An angle for an axis. The field is empty until a person types, or takes the encoder's value; never the counter's."""

    def __init__(self, axis: str) -> None:
        super().__init__()
        self._encoder_deg: float | None = None
        self._counter, self._encoder, self._apart = QLabel(), QLabel(), QLabel()
        self.field = AnswerField()
        self.field.setPlaceholderText(FROM_SCALE)
        self.field.setAccessibleName(f"Angle at which {axis} is, degrees")
        self.take = QPushButton("Use the &encoder")
        self.take.setAutoDefault(False)
        self.take.setAccessibleName(f"Enter the value of the encoder of {axis}")
        self.take.clicked.connect(self._take_encoder)
        self.field.setFixedWidth(self.field.fontMetrics().horizontalAdvance(FROM_SCALE) + 30)
        label = QLabel("&Angle, deg")
        label.setBuddy(self.field)
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(14)
        grid.setColumnStretch(3, 1)
        for column, (name, value) in enumerate(
            (("Counter", self._counter), ("Encoder", self._encoder), ("Difference", self._apart))
        ):
            grid.addWidget(QLabel(name), 0, column)
            grid.addWidget(value, 1, column)
            font = value.font()
            font.setBold(True)
            value.setFont(font)
            value.setAccessibleName(name)
            value.setMinimumWidth(value.fontMetrics().horizontalAdvance("−000.000°"))
        grid.addWidget(label, 2, 0)
        grid.addWidget(self.field, 2, 1)
        grid.addWidget(self.take, 2, 2)
        self.show_place(None, None)

    @property
    def place(self) -> str:
        """Counter, encoder and their difference as text."""
        return f"{self._counter.text()}, {self._encoder.text()}, {self._apart.text()}"

    @property
    def angle_deg(self) -> float | None:
        """The angle in the field; None where it has none."""
        return number_of(self.field.text(), DECIMALS)

    def show_place(self, counter_deg: float | None, encoder_deg: float | None, encoder_lost: bool = False) -> None:
        """Show counter and encoder, deg; None is unknown, an axis without an encoder, or one that is lost in a reset."""
        self._encoder_deg = encoder_deg
        apart = encoder_deg - counter_deg if encoder_deg is not None and counter_deg is not None else None
        for label, angle in ((self._counter, counter_deg), (self._encoder, encoder_deg), (self._apart, apart)):
            label.setText(NO_VALUE if angle is None else f"{round(angle, DECIMALS) + 0.0:.{DECIMALS}f}°".replace("-", "−"))
        if encoder_lost:
            self._encoder.setText(ENCODER_LOST)
        self.take.setEnabled(encoder_deg is not None)
        reason = f"the encoder's reference was {ENCODER_LOST}" if encoder_lost else "the encoder has no value"
        self.take.setToolTip("" if encoder_deg is not None else reason)

    @Slot()
    def _take_encoder(self) -> None:
        if self._encoder_deg is not None:
            self.field.setText(f"{round(self._encoder_deg, DECIMALS) + 0.0:.{DECIMALS}f}")
