"""The picture of the directions that a schedule measures."""

from goniotwin.app.campaign.planning.direction_map import DirectionMap
from goniotwin.app.desktop.disc import DiscView
from goniotwin.app.desktop.model.draft import map_panel
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.figures.description import Panel
from goniotwin.app.figures.style import MARKS, MarkKind, Symbol

FEW = 250
"""Directions of which each has room for a mark of the usual size."""
SIGNS: dict[Symbol, str] = {"circle": "●", "diamond": "◆", "triangle down": "▽", "square": "■"}


class DirectionsView(DiscView):
    """The directions of one incidence by their mark, with the key in words."""

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours, "Directions of the schedule")
        self.colour_bar.hide()
        self.set_colours(colours)

    def show_map(self, found: DirectionMap | None) -> None:
        """Show the directions of an incidence, or none."""
        panel = Panel(projection="disc") if found is None else map_panel(found)
        directions = sum(count for _, count, _ in counts(panel))
        self._items.mark_share = min(1.0, (FEW / max(directions, 1)) ** 0.5)
        self._items.show(panel)
        self._write("; ".join(f"{_sign(kind)} {count} {meaning}" for kind, count, meaning in counts(panel)))


def counts(panel: Panel) -> list[tuple[MarkKind, int, str]]:
    """The number of marks of each kind in a panel's key."""
    sizes = {each.kind: each.x.size for each in panel.marks}
    return [(kind, sizes[kind], meaning) for kind, meaning in panel.key]


def _sign(kind: MarkKind) -> str:
    style = MARKS[kind]
    return SIGNS[style.symbol] if style.filled or style.symbol != "circle" else "○"
