"""The start of a process that outlives this one."""

import contextlib
import subprocess
import sys
from typing import IO


def start_detached(
    command: list[str], stdin: int = subprocess.DEVNULL, output: "IO[bytes] | int" = subprocess.DEVNULL
) -> "subprocess.Popen[bytes]":
    """Start a process in a session of its own, where no Ctrl-C of this one's terminal reaches it. Raises OSError."""
    if sys.platform == "win32":
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.DETACHED_PROCESS
        with contextlib.suppress(PermissionError):  # a job that lets no process out
            return subprocess.Popen(
                command,
                stdin=stdin,
                stdout=output,
                stderr=output,
                creationflags=flags | subprocess.CREATE_BREAKAWAY_FROM_JOB,
            )
        return subprocess.Popen(command, stdin=stdin, stdout=output, stderr=output, creationflags=flags)
    return subprocess.Popen(command, stdin=stdin, stdout=output, stderr=output, start_new_session=True)
