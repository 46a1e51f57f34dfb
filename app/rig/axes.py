"""`[axes]` of a rig file: the axes and their motion controllers, of any kind."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Generic

from typing_extensions import TypeVar

from goniotwin.app.rig.kinds import MotionKind, motion_kind
from goniotwin.drivers import AxisDescription

AXES = ("gamma", "sigma", "beta", "shift")
AnyAxis = TypeVar("AnyAxis", bound=AxisDescription, default=AxisDescription)
"""The table of an axis: that of the controller of `[axes]`, or one with a controller of its own, of any registered kind."""


@dataclass(frozen=True)
class Controller:
    """A motion controller of a rig file: its name, its kind, the table with its own keys, and its axes.

    `places` are the paths of the tables that have its keys.
    """

    name: str
    kind: MotionKind
    table: Any
    axes: Mapping[str, AxisDescription]
    places: tuple[tuple[str, ...], ...]

    @property
    def port(self) -> str:
        """The address of its port."""
        return str(self.table.port)


@dataclass(frozen=True, kw_only=True)
class AxesTable(Generic[AnyAxis]):
    """The axes and their motion controllers.

    `gamma`: turns the sample about its normal. `sigma`: turns the mirror unit, and with it the incidence. `beta`: turns the arc
    about the vertical axis. `shift`: shifts the arc along itself, which makes fine polar angles.
    """

    gamma: AnyAxis
    sigma: AnyAxis
    beta: AnyAxis
    shift: AnyAxis

    def __post_init__(self) -> None:
        if (check := getattr(super(), "__post_init__", None)) is not None:
            check()  # of the controller's table, which extends this one
        controllers = self.controllers
        if hasattr(self, "port") and not any(("axes",) in each.places for each in controllers):
            raise ValueError("port: every axis has a controller of its own, so there is none of [axes]; remove kind and port")
        for controller in controllers:
            controller.kind.check_axes(controller.axes)

    @property
    def by_name(self) -> dict[str, AxisDescription]:
        """The tables of the axes, by name."""
        return {name: getattr(self, name) for name in AXES}

    @property
    def controllers(self) -> tuple[Controller, ...]:
        """The motion controllers: that of all axes without one of their own, `axes`, then the others, such as `axes-shift`.

        Raises ValueError for two tables of one port that contradict each other.
        """
        found: list[Controller] = []
        for name, axis in self.by_name.items():
            own = hasattr(axis, "port")
            table: Any = axis if own else self
            place = ("axes", name) if own else ("axes",)
            kind = motion_kind(table.kind)
            same = next((each for each in found if each.port == table.port), None)
            if same is None:
                found.append(Controller(f"axes-{name}" if own else "axes", kind, table, {name: axis}, (place,)))
                continue
            for key in ("kind", *(each.name for each in fields(kind.controller))):
                if getattr(same.table, key, None) != getattr(table, key):
                    other = ".".join(same.places[0])
                    raise ValueError(f"{name}.{key}: differs from that of {other}, which has the same port; correct one")
            places = same.places if place in same.places else (*same.places, place)
            shared = "axes" if ("axes",) in places else same.name
            found[found.index(same)] = replace(same, name=shared, axes={**same.axes, name: axis}, places=places)
        return tuple(sorted(found, key=lambda each: each.name != "axes"))
