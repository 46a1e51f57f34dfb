"""The window's model: the connection to the station and its messages, the values of a run, what is permitted now. No Qt.

The screens have these names, which are loaded at their first use: the window shows itself before numpy, the engine and the
optics are loaded. `Message` is one of the station.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.app.campaign.row import NO_SAMPLE as NO_SAMPLE
    from goniotwin.app.campaign.running.events import Positions as Positions
    from goniotwin.app.campaign.running.events import RowCommitted as RowCommitted
    from goniotwin.app.campaign.schedule.grids import grid_values as grid_values
    from goniotwin.app.desktop.model.draft import map_title as map_title
    from goniotwin.app.desktop.model.instrument import InstrumentModel as InstrumentModel
    from goniotwin.app.desktop.model.instrument import pose_text as pose_text
    from goniotwin.app.desktop.model.instrument import project as project
    from goniotwin.app.desktop.model.messages import Attached as Attached
    from goniotwin.app.desktop.model.messages import CommandRefused as CommandRefused
    from goniotwin.app.desktop.model.messages import NotAttached as NotAttached
    from goniotwin.app.desktop.model.messages import PastRead as PastRead
    from goniotwin.app.desktop.model.messages import RigRead as RigRead
    from goniotwin.app.desktop.model.messages import SamplesRead as SamplesRead
    from goniotwin.app.desktop.model.messages import StationLost as StationLost
    from goniotwin.app.desktop.model.messages import StopReport as StopReport
    from goniotwin.app.desktop.model.preflight import MARKS as MARKS
    from goniotwin.app.desktop.model.preflight import Outcome as Outcome
    from goniotwin.app.desktop.model.preflight import preflight_checks as preflight_checks
    from goniotwin.app.desktop.model.preflight import preflight_summary as preflight_summary
    from goniotwin.app.desktop.model.readings import BenchReadings as BenchReadings
    from goniotwin.app.desktop.model.readings import current_text as current_text
    from goniotwin.app.desktop.model.readings import trend_text as trend_text
    from goniotwin.app.desktop.model.results import PREDICTION as PREDICTION
    from goniotwin.app.desktop.model.results import THEORY as THEORY
    from goniotwin.app.desktop.model.results import Answered as Answered
    from goniotwin.app.desktop.model.results import Checked as Checked
    from goniotwin.app.desktop.model.results import Light as Light
    from goniotwin.app.desktop.model.results import Opened as Opened
    from goniotwin.app.desktop.model.results import ResultsFailed as ResultsFailed
    from goniotwin.app.desktop.model.results import ResultsReader as ResultsReader
    from goniotwin.app.desktop.model.results import View as View
    from goniotwin.app.desktop.model.results import first_light as first_light
    from goniotwin.app.desktop.model.results import nearest_light as nearest_light
    from goniotwin.app.desktop.model.results import value_texts as value_texts
    from goniotwin.app.desktop.model.rig_facts import RigFacts as RigFacts
    from goniotwin.app.desktop.model.tolerances import Studies as Studies
    from goniotwin.app.desktop.model.tolerances import StudyOutcome as StudyOutcome
    from goniotwin.app.desktop.model.tolerances import StudyProgress as StudyProgress
    from goniotwin.app.desktop.model.tolerances import read_content as read_content
    from goniotwin.app.desktop.model.tolerances import write_outcome as write_outcome
    from goniotwin.app.desktop.model.worker import WorkFailed as WorkFailed
    from goniotwin.app.figures.scale import linear_ticks as linear_ticks
    from goniotwin.app.station.messages import ActivityChanged as ActivityChanged
    from goniotwin.app.station.messages import BenchReading as BenchReading
    from goniotwin.app.station.messages import DeviceChanged as DeviceChanged
    from goniotwin.app.station.messages import Message as Message
    from goniotwin.app.station.messages import RigClosed as RigClosed
    from goniotwin.app.station.messages import RunBegun as RunBegun
    from goniotwin.app.station.messages import Snapshot as Snapshot
    from goniotwin.app.station.messages import advance as advance
else:
    __getattr__, __dir__ = first_use(__name__)
