"""The reduction on one page: the steps from the rows' readings to the BSDF dataset, in order.

Each step takes a dataset and gives the next one, with the components of the uncertainty that come in with it (components.py has
their convention, and u). A further correction or contribution is a function in a file of its own, and one line in a list here
or, if its inputs are shared by many values, in SHARED of scale.py.
Journal, live plot and rehearsal have no other reduction.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from goniotwin.app.campaign.reduction.components import Signal, total_variance
from goniotwin.app.campaign.reduction.effects_of_points import add_pose
from goniotwin.app.campaign.reduction.etalon import (
    ArcRows,
    ReductionSettings,
    ReferenceSignals,
    RowSignals,
    add_monitor_changes,
    apply_certificate,
    divide_by_etalon,
    flag_values,
    gain_variance,
    join_references,
    linearity_variance,
    make_points,
    monitor_variance,
    subtract_signature,
)
from goniotwin.app.campaign.reduction.evidence import SignalEvidence, add_scatter, correct_gain, link_gains, stated
from goniotwin.app.campaign.reduction.field_of_view import correct_field_of_view
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.scale import SHARED
from goniotwin.app.campaign.reduction.signals import (
    DarkReadings,
    add_crosstalk,
    add_tracing_error,
    check_readings,
    choose_gain,
    convert_to_photocurrent,
    divide_by_monitor,
    group_readings,
    subtract_dark,
)
from goniotwin.app.campaign.reduction.spectrum import correct_band
from goniotwin.app.campaign.row import ReadingTable
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ConverterDescription

QUOTIENT_VARIANCES: Mapping[str, Callable[[Signal, Signal, RigFile], Floats | float]] = {
    "monitor": lambda one, other, rig: monitor_variance(rig),  # noqa: ARG005
    "gain": gain_variance,
    "linearity": linearity_variance,
}
"""Relative variances of a quotient of two rows' signals, besides those of the signals, by component.

They hold for a sample over the etalon and for a drift check over the first one. One that is a number, no array, is common to
all photodiodes of a row.
"""


def add_quotient_uncertainty(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Add the components of QUOTIENT_VARIANCES."""
    for name, relative in QUOTIENT_VARIANCES.items():
        data = data.with_component(name, relative(data.sample, data.etalon, settings.rig) * data.estimate.value**2)
    return data


def calibrate_photodiodes(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """Multiply by the calibration factors of the overlaps, where the schedule asks for it."""
    return points if settings.calibration is None else settings.calibration.apply(points)


ARC_STEPS: Sequence[Callable[[ArcRows, ReductionSettings], ArcRows]] = (
    subtract_signature,
    divide_by_etalon,
    add_quotient_uncertainty,
    correct_band,
    apply_certificate,
    add_monitor_changes,
    flag_values,
)
"""From the signals of rows, at the sample, at the etalon and without a sample, to the BSDF: on the rows of one arc."""

SETTING_STEPS: Sequence[Callable[[BsdfPoints, ReductionSettings], BsdfPoints]] = (
    calibrate_photodiodes,
    correct_field_of_view,  # after the calibration: the field has the same effect on all photodiodes that look in a direction
    add_pose,  # after the slopes
)
"""Steps on all points of a set of wavelength, sigma and gamma, and of a sample's calibration: they need the points nearby."""


def reduce_readings(
    table: ReadingTable,
    dark: Mapping[float, DarkReadings],
    settings: ConverterDescription,
    rig: RigFile,
    evidence: SignalEvidence | None = None,
) -> Signal:
    """The signals (rows, photodiodes): photocurrents over the monitor's current, each at its highest unsaturated gain.

    `dark` are the dark readings by gain, `evidence` is what the campaign's rows show; None before there are any.
    Raises UserError for a gain without a dark reading, for a gain that the rig does not have, for counts of other photodiodes,
    and for a monitor without light.
    """
    at_gains = []
    known = stated(rig) if evidence is None else evidence
    check_readings(table, dark, settings)
    for readings in group_readings(table):
        of_gain = dark[readings.gain_v_per_a]
        volts = subtract_dark(readings, of_gain, settings)
        volts = add_crosstalk(volts, readings, settings, known.crosstalk)
        current = convert_to_photocurrent(volts, readings, settings)
        current = correct_gain(add_scatter(current, readings, settings, known), readings, settings, known)
        at_gains.append((readings, divide_by_monitor(current, readings, of_gain)))
    return link_gains(add_tracing_error(choose_gain(at_gains, table.rows, settings), rig), known)


def reduce_rows(rows: RowSignals, references: ReferenceSignals, settings: ReductionSettings) -> tuple[Ints, BsdfPoints] | None:
    """The points of rows of one sample, that of the settings, and the index of each point's row.

    None where the etalon was not measured at any pose.
    """
    arcs = join_references(rows, references, settings)
    for step in ARC_STEPS:
        arcs = [(index, step(data, settings)) for index, data in arcs]
    if not arcs:
        return None
    index, points = make_points(arcs)
    return index, add_shared(points, settings)


def add_shared(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """Add a component for each family of inputs in SHARED."""
    found = {name: effects_of(points, settings) for name, effects_of in SHARED.items()}
    components = {name: total_variance(each.variances()) for name, each in found.items() if each is not None}
    return replace(points, components={**points.components, **components})


def finish_points(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """The BSDF of whole settings of one sample."""
    for step in SETTING_STEPS:
        points = step(points, settings)
    return points
