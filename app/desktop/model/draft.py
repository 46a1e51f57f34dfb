"""A schedule that is being written: its plan for the rig of the window, made in a thread for the latest text. No Qt."""

import contextlib
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.direction_map import DirectionMap, direction_maps
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.planning.templates import make_schedule
from goniotwin.app.campaign.schedule.editing import key_span
from goniotwin.app.campaign.schedule.file import schedule_at
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.desktop.model.planner import NO_RIG, description_of
from goniotwin.app.errors import UserError
from goniotwin.app.figures.description import Colour, Marks, Panel
from goniotwin.app.figures.hemisphere import disc_marks, places, ring_lines
from goniotwin.app.figures.style import MarkKind
from goniotwin.app.station.messages import RigOpened
from goniotwin.arrays import Floats

KINDS: dict[str, tuple[MarkKind, str]] = {
    "images": ("below", "image of a measured direction, by symmetry"),
    "omitted": ("transmitted", "omitted, as it follows by symmetry"),
    "checks": ("steep", "measured to check the symmetry"),
    "measured": ("measured", "measured"),
    "blocked": ("blocked", "blocked by the mirror unit"),
}
"""By name in `DirectionMap`, the mark of a direction and its meaning."""
LINE = re.compile(r"at line (\d+)")


@dataclass(frozen=True)
class TemplateChoice:
    """What a person has chosen of a new schedule."""

    template: str
    sample: str
    etalon: str
    relative_u: float
    longest_h: float


@dataclass(frozen=True)
class Drafted:
    """What comes of a text: facts of its plan in words and its directions, or an error with its line, from 1.

    `of_template`: the text is that of a template, with its `notes`.
    """

    number: int
    text: str
    facts: tuple[str, ...] = ()
    maps: tuple[DirectionMap, ...] = ()
    warnings: tuple[str, ...] = ()
    error: str = ""
    line: int | None = None
    of_template: bool = False
    notes: tuple[str, ...] = ()


class DraftPlanner:
    """Plans texts; `deliver` gets a `Drafted` for the latest one, in a thread."""

    def __init__(self, deliver: Callable[[Drafted], None]) -> None:
        self._deliver = deliver
        self._lock = threading.Lock()
        self._number = 0
        self._making = False

    def plan(self, text: str, path: Path, rig: RigOpened | None) -> None:
        """Plan a text as that of a file `path`; return at once. Nothing is planned while a template is written."""
        if not self._making:
            self._begin(lambda number: _drafted(number, text, path, rig))

    def make(self, choice: TemplateChoice, path: Path, rig: RigOpened | None) -> None:
        """Write the text of a template; return at once."""
        self._making = True
        self._begin(lambda number: _made(number, choice, path, rig))

    def close(self) -> None:
        """Deliver nothing after this."""
        with self._lock:
            self._number += 1

    def _begin(self, work: Callable[[int], Drafted]) -> None:
        self.close()
        threading.Thread(target=self._work, args=(work, self._number), name="draft", daemon=True).start()

    def _work(self, work: Callable[[int], Drafted], number: int) -> None:
        found = work(number)
        with self._lock:
            if number == self._number:
                self._making = False
                with contextlib.suppress(RuntimeError):  # the window is gone
                    self._deliver(found)


def _drafted(number: int, text: str, path: Path, rig: RigOpened | None) -> Drafted:
    try:
        schedule = schedule_at(text, path)
        if rig is None:
            return Drafted(number, text, error=NO_RIG)
        return _of_plan(number, text, make_plan(schedule, description_of(rig)))
    except UserError as error:
        return Drafted(number, text, error=str(error), line=line_of(str(error), text, str(path)))
    except Exception as error:  # noqa: BLE001  (of any library: reported, and the window stays open)
        return Drafted(number, text, error=f"unexpected error: {type(error).__name__}: {error}")


def _made(number: int, choice: TemplateChoice, path: Path, rig: RigOpened | None) -> Drafted:
    if rig is None:
        return Drafted(number, "", error=NO_RIG, of_template=True)
    try:
        each = choice
        made = make_schedule(
            each.template, description_of(rig), str(path), each.sample, each.etalon, each.relative_u, each.longest_h
        )
    except UserError as error:
        return Drafted(number, "", error=str(error), of_template=True)
    return Drafted(number, made.text, of_template=True, notes=made.notes)


def _of_plan(number: int, text: str, plan: NewPlan) -> Drafted:
    check = check_plan(plan)
    facts = (
        f"{check.rows} rows, about {duration_text(plan.seconds)}",
        f"{plan.seconds / 3600.0:.2g} lamp hours",
        f"mountings: {', '.join(check.mountings)}",
        f"{check.directions} directions, {check.shadowed} of them blocked by the mirror unit",
        *([f"{check.left_out} poses omitted by symmetry"] if check.left_out else []),
    )
    return Drafted(number, text, facts, tuple(direction_maps(plan)), tuple(check.warnings))


def line_of(error: str, text: str, name: str) -> int | None:
    """The line of a text that an error is about, from 1: the one that it states, or that of its key."""
    if (found := LINE.search(error)) is not None:
        return int(found.group(1))
    key = error.removeprefix(f"{name}: ").partition(":")[0]
    parts = tuple(key.split("."))
    for length in range(len(parts), 0, -1):
        try:
            span = key_span(text, parts[:length])
        except ValueError:  # it is not TOML
            return None
        if span is not None:
            return text.count("\n", 0, span[0]) + 1
    return None


def map_title(found: DirectionMap) -> str:
    """The incidence of a map in words."""
    return f"σ {found.sigma_deg:g}°{', back' if found.back else ''}{', transmitted' if found.transmitted else ''}"


def map_panel(found: DirectionMap) -> Panel:
    """The picture of the directions of one incidence."""

    def marks(kind: MarkKind, angles: Floats) -> Marks:
        colour: Colour = {"measured": "points", "below": "dim"}.get(kind, "predicted")
        return Marks(kind, *places(angles[:, 0], angles[:, 1]), colour)

    drawn = [marks(kind, getattr(found, name)) for name, (kind, _) in KINDS.items()]
    key = tuple((kind, words) for name, (kind, words) in KINDS.items() if len(getattr(found, name)))
    return Panel(projection="disc", key=key, series=ring_lines(), marks=(*drawn, *disc_marks(found.sigma_deg)))
