"""The conclusion of a measured campaign, computed in a worker. No Qt."""

from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.rehearsal.conclusion import conclude
from goniotwin.app.desktop.model.worker import WorkFailed, answer_of


def serve_conclusion(connection: "Connection[Any, Any]") -> None:
    """Conclude one journal, whose path is the first request; the answer is a Conclusion or WorkFailed."""
    path: Path = connection.recv()
    connection.send(answer_of(lambda: conclude(path), WorkFailed))
