"""The reduction on one page: the steps from the rows' readings to the BSDF dataset, in order.

Each step takes a dataset and gives the next one; a `Quantity` carries the values with the effects of their inputs. A further
correction or contribution is a function in a file of its own, and one line in a list here or, if its inputs follow from pose
and files, in `shared_families` of scale.py. Journal, live plot and rehearsal have no other reduction.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from goniotwin.app.campaign.reduction.angles import add_pose
from goniotwin.app.campaign.reduction.arc_rows import ArcRows
from goniotwin.app.campaign.reduction.components import Signal, total_variance
from goniotwin.app.campaign.reduction.etalon import (
    ReferenceSignals,
    apply_certificate,
    divide_by_etalon,
    flag_values,
    join_references,
    make_points,
    subtract_signature,
)
from goniotwin.app.campaign.reduction.evidence import SignalEvidence, add_gains, add_scatter, correct_gain, stated
from goniotwin.app.campaign.reduction.field_of_view import correct_field_of_view
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.row_signals import RowSignals
from goniotwin.app.campaign.reduction.scale import shared_families, state_interval
from goniotwin.app.campaign.reduction.settings import ReductionSettings
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
from goniotwin.arrays import Ints
from goniotwin.drivers import ConverterDescription


def calibrate_photodiodes(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """Multiply by the calibration factors of the overlaps, where the schedule asks for it."""
    first = settings.sample_number * settings.rig.photodiodes.count  # each sample has factors of its own
    return points if settings.calibration is None else settings.calibration.apply(points, first)


ARC_STEPS: Sequence[Callable[[ArcRows, ReductionSettings], ArcRows]] = (
    subtract_signature,
    divide_by_etalon,
    correct_band,
    apply_certificate,
    flag_values,
)
"""From the signals of rows, at the sample, at the etalon and without a sample, to the BSDF: on the rows of one arc."""

SETTING_STEPS: Sequence[Callable[[BsdfPoints, ReductionSettings], BsdfPoints]] = (
    calibrate_photodiodes,
    correct_field_of_view,  # after the calibration: the field has the same effect on all photodiodes that look in a direction
    add_pose,  # after the slopes
    state_interval,  # by all components
)
"""Steps on all points of a set of wavelength, sigma and gamma, and of a sample's calibration: they need the points nearby."""


def reduce_readings(
    table: ReadingTable,
    numbers: Ints,
    dark: Mapping[float, DarkReadings],
    settings: ConverterDescription,
    rig: RigFile,
    evidence: SignalEvidence | None = None,
) -> Signal:
    """The signals (rows, photodiodes): photocurrents over the monitor's current, each at its highest unsaturated gain.

    `numbers` (rows,) are those of the rows, `dark` the dark readings by gain, `evidence` is what the campaign's rows
    show; None before there are any.
    Raises UserError for a gain without a dark reading, for a gain that the rig does not have, for counts of other photodiodes,
    and for a monitor without light.
    """
    at_gains = []
    known = stated(rig) if evidence is None else evidence
    check_readings(table, dark, settings)
    for readings in group_readings(table, numbers):
        of_gain = dark[readings.gain_v_per_a]
        volts = subtract_dark(readings, of_gain, settings)
        volts = add_crosstalk(volts, readings, settings, known.crosstalk)
        current = convert_to_photocurrent(volts, readings, settings)
        current = correct_gain(add_scatter(current, readings, rig, known), readings, settings, known)
        at_gains.append((readings, divide_by_monitor(current, readings, of_gain, rig)))
    return add_gains(add_tracing_error(choose_gain(at_gains, table.rows, settings), rig), rig, known)


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
    """Add the variance by each family of inputs that points share."""
    found = {name: effects_of(points, settings) for name, effects_of in shared_families().items()}
    variances = {name: total_variance(each.variances()) for name, each in found.items() if each is not None}
    return replace(points, stated={**points.stated, **variances})


def finish_points(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """The BSDF of whole settings of one sample."""
    for step in SETTING_STEPS:
        points = step(points, settings)
    return points
