"""The JSON Schema of the kinds of files."""

import json
from pathlib import Path
from typing import Literal

from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.cli.output import error_console
from goniotwin.app.formats.file import write_file
from goniotwin.app.rig import rig_file_table
from goniotwin.app.rig.kinds import load_all_plugins
from goniotwin.app.simulation.tolerances.study import StudyFile
from goniotwin.app.toml_file import json_schema


def write_schema(kind: Literal["rig", "schedule", "tolerances"], out: Path | None) -> None:
    """Write the schema of a kind of file, or print it. Raises UserError."""
    for fault in load_all_plugins():
        error_console().print(f"goniotwin: {fault}; the schema does not have it", markup=False)
    text = json.dumps(
        json_schema(
            {"rig": rig_file_table(), "schedule": ScheduleFile, "tolerances": StudyFile}[kind], f"goniotwin {kind} file"
        ),
        indent=2,
    )
    if out is None:
        print(text)
        return
    write_file(out, f"{text}\n".encode())
