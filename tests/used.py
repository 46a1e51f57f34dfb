"""What a command uses, memory and CPU time, of itself alone.

The system counts the memory of a process from that of the one that started it: the command is started by a small one.
"""

import json
import subprocess
import sys
from dataclasses import dataclass

STARTER = """
import json, resource, subprocess, sys
done = subprocess.run(sys.argv[1:], capture_output=True, text=True)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
peak = used.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
print(json.dumps([done.returncode, done.stdout, done.stderr, peak, used.ru_utime + used.ru_stime]))
"""


@dataclass(frozen=True)
class Used:
    """The end of a command: exit status, what it printed, its greatest memory in bytes, its CPU time in s."""

    status: int
    stdout: str
    stderr: str
    peak_bytes: int
    cpu_s: float


def run(*command: str) -> Used:
    """Run a command to its end."""
    done = subprocess.run([sys.executable, "-S", "-c", STARTER, *command], stdout=subprocess.PIPE, text=True, check=True)
    return Used(*json.loads(done.stdout))
