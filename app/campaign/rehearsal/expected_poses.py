"""The poses that a virtual rig is going to be asked for: the plan knows them before their rows."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType

from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.rig import AXES
from goniotwin.drivers import Rig
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.twin.plant import ExpectedPose

NONE: Mapping[str, int] = MappingProxyType({})


def expected_poses(rows: Iterable[Row], rig: Rig, before: Mapping[str, int] = NONE) -> Iterator[ExpectedPose]:
    """The poses of rows that begin with a mounting, as the drivers of a rig set them; none for an axis of another make.

    `before` is how often each sample was mounted before.
    """
    settings = {name: axis.settings for name, axis in rig.axes.items()}
    mounted, mountings, position = None, Counter(before), 1
    for row in rows:
        if row.kind == "mount":
            if mounted != row.sample and row.sample != NO_SAMPLE:
                mountings[row.sample] += 1
            mounted = row.sample
        if row.pose is None or row.wavelength_nm is None or mounted is None:
            continue
        counters = {}
        for name, target in zip(AXES, row.pose, strict=True):
            own = settings[name]
            if not isinstance(own, AxisSettings):
                return
            counters[name] = float(own.counter(target))
        order_filter = rig.monochromator.settings.wheel.at(row.wavelength_nm)
        position = position if order_filter is None else order_filter.position
        empty = mounted == NO_SAMPLE
        yield ExpectedPose(
            None if empty else mounted, 0 if empty else mountings[mounted], row.wavelength_nm, position, counters
        )
