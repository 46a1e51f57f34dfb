"""The controls of light and readings: wavelength, shutter, gain and sample; one reading, a dark reading, live readings."""

from collections.abc import Sequence

from PySide6.QtCore import Signal, Slot
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from goniotwin.app.desktop.bench.number_field import NumberField

UNKNOWN = "unknown"
MOST_READINGS = 1000


class LightControls(QGroupBox):
    """Wavelength, shutter, gain, sample and readings. `command` has a station's command and its arguments; `refused` why what
    was entered is not done.
    """

    command = Signal(str, object)
    refused = Signal(str)

    def __init__(self) -> None:
        super().__init__("Light and readings")
        self.setAccessibleName("Light and readings")
        self._shutter_open: bool | None = None
        self.wavelength = NumberField("Wavelength, nanometres", 0.0, 9999.0, 1)
        self.wavelength.setSuffix(" nm")
        self.wavelength.setValue(550.0)
        self._entered = False
        self._no_wavelength = ""
        self.set_wavelength_button = _button("Set", "Set the wavelength")
        self._wavelength_now = QLabel()
        self.shutter = _button("Open", "Open the shutter")
        self._shutter_now = QLabel()
        self.gain = QComboBox()
        self.gain.setAccessibleName("Gain of the amplifiers")
        self.sample = QComboBox()
        self.sample.setAccessibleName("Sample in the virtual rig")
        self.sample_label = QLabel("Sample")
        for box in (self.gain, self.sample):
            box.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
            box.setMinimumContentsLength(6)
        self.readings = NumberField("Number of conversions in a reading", 1, MOST_READINGS, 0)
        self.readings.setValue(4)
        self.readings.setPrefix("× ")
        self.readings.setToolTip("Conversions that one reading is the mean of")
        self.read = _button("Read", "Read all photodiodes once")
        self.dark = _button("Dark reading", "Take a dark reading now")
        self.live = QCheckBox("Liv&e")
        self.live.setAccessibleName("Live readings")
        self._lay_out()
        for field in (self.wavelength, self.readings):
            field.refused.connect(self.refused)
        self.wavelength.typed.connect(self._note_entry)
        self.wavelength.valueChanged.connect(self._note_entry)
        self.set_wavelength_button.clicked.connect(self._set_wavelength)
        self.wavelength.lineEdit().returnPressed.connect(self._set_wavelength_by_key)
        self.shutter.clicked.connect(self._turn_shutter)
        self.gain.activated.connect(self._set_gain)
        self.sample.activated.connect(self._mount)
        self.read.clicked.connect(self._read)
        self.dark.clicked.connect(self._read_dark)
        self.live.clicked.connect(self._set_live)
        self.set_gains(())
        self.set_samples(())
        self.set_settings(None, None, None, None, False)

    def _lay_out(self) -> None:
        grid = QGridLayout(self)
        grid.setContentsMargins(8, 4, 8, 6)
        grid.setHorizontalSpacing(10)
        grid.setVerticalSpacing(3)
        grid.setColumnStretch(0, 1)
        grid.setColumnStretch(1, 1)
        grid.addLayout(_row(QLabel("λ"), self.wavelength, self.set_wavelength_button), 0, 0)
        grid.addLayout(_row(QLabel("Shutter"), self._shutter_now, self.shutter), 0, 1)
        grid.addLayout(_row(QLabel("Gain"), self.gain), 1, 0)
        grid.addLayout(_row(self.sample_label, self.sample), 1, 1)
        readings = QHBoxLayout()
        readings.setSpacing(4)
        for each in (self.read, self.readings, self.dark, self.live):
            readings.addWidget(each)
        readings.addStretch(1)
        grid.addLayout(readings, 2, 0, 1, 2)

    # What is known.

    def set_gains(self, gains_v_per_a: Sequence[float]) -> None:
        """Take the gains of the rig."""
        self.gain.clear()
        self.gain.setPlaceholderText(UNKNOWN)
        for each in gains_v_per_a:
            self.gain.addItem(f"{each:.0e} V/A".replace("e+0", "e").replace("e+", "e"), each)
        self.gain.setCurrentIndex(-1)

    def set_samples(self, samples: Sequence[str]) -> None:
        """Take the samples of a virtual rig; without any, samples are not mounted from here."""
        self.sample.clear()
        self.sample.setPlaceholderText("not chosen")
        self.sample.addItems(list(samples))
        self.sample.setCurrentIndex(-1)
        for each in (self.sample, self.sample_label):
            each.setVisible(bool(samples))

    def set_wavelengths(self, lowest_nm: float, highest_nm: float) -> None:
        """Take the range of the monochromator."""
        self.wavelength.setToolTip(f"{lowest_nm:g} to {highest_nm:g} nm")

    def set_settings(
        self, wavelength_nm: float | None, shutter_open: bool | None, gain_v_per_a: float | None, sample: str | None, live: bool
    ) -> None:
        """Show the settings as far as they are known."""
        if wavelength_nm is not None and not self._entered and wavelength_nm != self.wavelength.value():
            self.wavelength.setValue(wavelength_nm)
            self._entered = False
        self.set_wavelength_button.setToolTip(
            "Set the wavelength (Enter)" if wavelength_nm is None else f"Set the wavelength, now {wavelength_nm:g} nm (Enter)"
        )
        self._shutter_open = shutter_open
        self._shutter_now.setText("?" if shutter_open is None else "open" if shutter_open else "closed")
        self._shutter_now.setAccessibleName(f"Shutter {UNKNOWN if shutter_open is None else self._shutter_now.text()}")
        self._shutter_now.setToolTip("unknown: the monochromator is not responding" if shutter_open is None else "")
        self.shutter.setText("Close" if shutter_open else "Open")
        self.shutter.setAccessibleName("Close the shutter" if shutter_open else "Open the shutter")
        self.gain.setCurrentIndex(-1 if gain_v_per_a is None else self.gain.findData(gain_v_per_a))
        if sample is not None:
            self.sample.setCurrentIndex(self.sample.findText(sample))
        self.live.setChecked(live)

    def set_refusals(self, refusals: dict[str, str]) -> None:
        """Disable what is refused now; the reasons are the tool tips."""
        controls: tuple[tuple[QWidget, str, str], ...] = (
            (self.set_wavelength_button, "wavelength", self.set_wavelength_button.toolTip()),
            (self.shutter, "shutter", self.shutter.accessibleName()),
            (self.gain, "gain", "Gain of all amplifiers"),
            (self.sample, "mount", "Sample that is mounted in the virtual rig"),
            (self.read, "read", "Read all photodiodes and the monitor once"),
            (self.dark, "read", "Read with the shutter closed; it is then as before"),
            (self.live, "live", "Read again and again; rests while anything else is read or set"),
        )
        self._no_wavelength = refusals.get("wavelength", "")
        for control, command, tip in controls:
            reason = refusals.get(command, "")
            control.setEnabled(not reason)
            control.setToolTip(reason or tip)

    # What is wanted.

    @Slot()
    def _set_wavelength_by_key(self) -> None:
        if self.set_wavelength_button.isEnabled():
            self._set_wavelength()
        else:
            self.refused.emit(f"the wavelength is not set: {self._no_wavelength}")

    @Slot()
    def _note_entry(self) -> None:
        self._entered = True

    @Slot()
    def _set_wavelength(self) -> None:
        if (nm := self.wavelength.entered()) is not None:
            self._entered = False
            self.command.emit("wavelength", {"nm": nm})

    @Slot()
    def _turn_shutter(self) -> None:
        self.command.emit("shutter", {"opened": not self._shutter_open})

    @Slot(int)
    def _set_gain(self, index: int) -> None:
        self.command.emit("gain", {"v_per_a": self.gain.itemData(index)})

    @Slot(int)
    def _mount(self, index: int) -> None:
        self.command.emit("mount", {"sample": self.sample.itemText(index)})

    @Slot()
    def _read(self) -> None:
        self._send_read(dark=False)

    @Slot()
    def _read_dark(self) -> None:
        self._send_read(dark=True)

    def _send_read(self, *, dark: bool) -> None:
        if (readings := self.readings.entered()) is not None:
            self.command.emit("read", {"readings": int(readings), "dark": dark})

    @Slot(bool)
    def _set_live(self, on: bool) -> None:
        self.command.emit("live", {"on": on})


def _row(first: QWidget, second: QWidget, *others: QWidget) -> QHBoxLayout:
    """Widgets beside each other; the second has the room that is left."""
    row = QHBoxLayout()
    row.setSpacing(4)
    row.addWidget(first)
    row.addWidget(second, 1)
    for each in others:
        row.addWidget(each)
    return row


def _button(text: str, name: str) -> QPushButton:
    button = QPushButton(text)
    button.setAccessibleName(name)
    button.setToolTip(name)
    button.setAutoDefault(False)
    width = max(button.fontMetrics().horizontalAdvance(each) for each in (text, "Close" if text == "Open" else text))
    button.setFixedWidth(width + 20)
    return button
