"""The hemisphere of a run: the disc of the setting in progress, which fills as rows arrive."""

import numpy as np
from PySide6.QtCore import QPointF, Slot

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.desktop.disc import PLANNED, DiscView
from goniotwin.app.desktop.model.live_scan import Setting
from goniotwin.app.desktop.model.run_points import MapPoints
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.figures.curves import quantity
from goniotwin.app.figures.description import Marks, Panel, Series
from goniotwin.app.figures.hemisphere import HORIZON_DEG, disc_marks, places, ring_lines, value_bar
from goniotwin.app.figures.scale import scale_of
from goniotwin.app.figures.style import MarkKind
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, incidence_deg, is_lit_from_behind, zenith_and_azimuth

NOTHING = "Measured directions appear here."
MORE_POINTS = 1.05
"""Growth of the number of points after which their scale is computed again, unless their extremes change."""
NEAR_DEG = 5.0
"""Distance of the mouse from a point whose value is shown."""


class HemisphereMap(DiscView):
    """The values of a setting over the hemisphere; points in alarm have a red square, those not to be trusted a cross."""

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours, "Hemisphere of the run")
        self._setting: Setting | None = None
        self._shown: MapPoints | None = None
        self._plane: tuple[Series, ...] = ()
        self._ends, self._scaled = (0.0, 0.0), 0
        self._view.scene().sigMouseMoved.connect(self._follow_mouse)
        self.set_colours(colours)
        self.clear()

    def clear(self, mark: str = "", *, mirrored: bool = False) -> None:
        """Clear the map; `mark` is its title (SIMULATED, or empty). `mirrored`: half of an isotropic sample is measured."""
        self._mark, self._mirrored = mark, mirrored
        self._show_mark()
        self._setting, self._shown, self._plane = None, None, ()
        self._empty()
        self.colour_bar.set_bar(None)
        self._write(NOTHING)
        self._show_panel()
        self._paint()

    def begin(self, setting: Setting, planned: MapPoints) -> None:
        """Show a setting from now on, none of which is measured; `planned` are its directions, as far as they are known."""
        self._setting, self._shown = setting, None
        self._empty()
        for rows, columns in self._pixels(*self._places(planned)):
            self._levels[rows, columns] = PLANNED
        self._set_density(int(np.count_nonzero(self._levels)))
        self._show_panel()

    @property
    def setting(self) -> Setting | None:
        """The setting that is shown."""
        return self._setting

    def stamp(self, points: MapPoints) -> None:
        """Add points of the setting; `show_points` paints them."""
        shown = points.where(~points.untrusted)
        self._stamp(*self._places(shown), shown.values)

    def show_points(self, points: MapPoints, planned: int, label: str = "") -> None:
        """Paint what has been stamped; `points` are all of the setting, for the bar, the marks and the text."""
        self._shown = points
        trusted = points.where(~points.untrusted) if points.untrusted.any() else points
        if trusted.values.size:
            self._update_bar(trusted, label or quantity(None), last=points.values.size == planned)
        self._show_panel()
        text = f"{points.values.size} directions" if not planned else f"{points.values.size} of {planned} directions"
        if trusted.values.size:
            top = int(np.argmax(trusted.values))
            text += f", highest {trusted.values[top]:.3g} at zenith {trusted.zenith_deg[top]:.0f}°"
            text += f", azimuth {trusted.azimuth_deg[top]:.0f}°"
        alarms = int(points.alarms.sum())
        self._write(text + (f", ✗ {alarms} in alarm" if alarms else ""))
        self._paint()

    def _update_bar(self, points: MapPoints, label: str, *, last: bool) -> None:
        """Compute the scale of all points again where it may be another: it takes longer than all else of a repaint."""
        bar, size = self.colour_bar.bar, points.values.size
        ends = float(points.values.min()), float(points.values.max())
        if bar is not None and label == bar.label and ends == self._ends and not last and size < MORE_POINTS * self._scaled:
            return
        self._ends, self._scaled = ends, size
        self._set_bar(value_bar(scale_of(points.values, points.u_values, None), points.values, label))

    def show_plane(self, plane_deg: float | None, phi_deg: float | None) -> None:
        """Show the line of the cut: of the arc's plane at an azimuth, or of a plane through the specular direction."""
        if self._setting is None:
            return
        if phi_deg is None:
            polar, azimuth = np.full(2, HORIZON_DEG), np.array([plane_deg or 0.0, (plane_deg or 0.0) + HALF_TURN_DEG])
        else:
            signed = np.linspace(-180.0, 180.0, 361)
            phi = np.where(signed < 0.0, phi_deg + HALF_TURN_DEG, phi_deg)
            vectors = from_specular(incidence_deg(self._setting[2]), np.abs(signed), phi)
            polar, azimuth = zenith_and_azimuth(vectors[vectors[:, 2] >= -1e-9])
        self._plane = (Series(*places(polar, self._around(azimuth)), "predicted", line="dashed"),)
        self._show_panel()

    def _show_panel(self) -> None:
        """Show rings, plane and marks."""
        marks: tuple[Marks, ...] = ()
        if self._setting is not None:
            marks = disc_marks(incidence_deg(self._setting[2]))
        if self._shown is not None:
            groups: dict[MarkKind, Flags] = {"untrusted": self._shown.untrusted, "alarm": self._shown.alarms}
            some = {kind: self._shown.where(chosen) for kind, chosen in groups.items() if chosen.any()}
            marks += tuple(Marks(kind, *self._places(each)) for kind, each in some.items())
        self._items.show(Panel(projection="disc", series=(*ring_lines(), *self._plane), marks=marks))

    @Slot(object)
    def _follow_mouse(self, at: QPointF) -> None:
        """Show the value of the direction under the mouse."""
        points = self._shown
        if points is None or not points.values.size:
            return
        mouse = self._plot.vb.mapSceneToView(at)
        x, y = self._places(points)
        nearest = int(np.argmin((x - mouse.x()) ** 2 + (y - mouse.y()) ** 2))
        near = np.hypot(x[nearest] - mouse.x(), y[nearest] - mouse.y()) < NEAR_DEG
        where = f"zenith {points.zenith_deg[nearest]:.1f}°, azimuth {points.azimuth_deg[nearest]:.1f}°"
        self._view.setToolTip(f"{where}: {points.values[nearest]:.4g}" if near else "")

    def _around(self, azimuth_deg: Floats) -> Floats:
        """Azimuths from the light's, counter-clockwise about the normal of the lit side."""
        return -azimuth_deg if self._setting is not None and is_lit_from_behind(self._setting[2]) else azimuth_deg

    def _places(self, points: MapPoints) -> tuple[Floats, Floats]:
        return places(polar_from_zenith(points.zenith_deg), self._around(points.azimuth_deg))
