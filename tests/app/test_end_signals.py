"""Signals that end the program, handled by a function instead of a KeyboardInterrupt."""

import os
import signal
import subprocess
import sys

import pytest

from goniotwin.app.end_signals import END_SIGNALS, call_on_end_signal, interrupt_on_end_signal

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="this system sends no signals to a process"),
    pytest.mark.usefixtures("heard_hangup"),
]
OVERDUE_STOP = """
import signal
from goniotwin.app import end_signals

end_signals.LONGEST_STOP_S = 0.0
with end_signals.call_on_end_signal(lambda: print("stopping", flush=True)):
    while True:
        signal.raise_signal(signal.SIGTERM)
"""
LATE_SIGNAL = """
import os, signal, sys
from goniotwin.app.end_signals import call_on_end_signal, interrupt_on_end_signal

class Last:
    kill, number, process = os.kill, signal.SIGTERM, os.getpid()
    def __del__(self):  # while the interpreter ends, after it has restored the system's handlers
        Last.kill(Last.process, Last.number)

last = Last()
interrupt_on_end_signal()
with call_on_end_signal(lambda: None):
    signal.raise_signal(signal.SIGTERM)
sys.exit(130)
"""


def test_without_a_signal_the_handlers_are_restored() -> None:
    before = [signal.getsignal(number) for number in END_SIGNALS]
    with call_on_end_signal(lambda: None) as handlers:
        assert all(signal.getsignal(number) == handlers.handle_first for number in END_SIGNALS)
    assert [signal.getsignal(number) for number in END_SIGNALS] == before
    assert not handlers.received


@pytest.mark.parametrize("number", END_SIGNALS)
def test_the_first_signal_calls_the_function_and_later_signals_are_ignored(number: int) -> None:
    before = {each: signal.getsignal(each) for each in END_SIGNALS}
    calls: list[str] = []
    try:
        interrupt_on_end_signal()
        with call_on_end_signal(lambda: calls.append("stop")) as handlers:
            os.kill(os.getpid(), number)
            for each in (*END_SIGNALS, number):
                os.kill(os.getpid(), each)
        for each in END_SIGNALS:  # after the context too: the program may still be closing its files
            os.kill(os.getpid(), each)
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    assert calls == ["stop"]
    assert handlers.received


def test_after_a_signal_the_handlers_of_a_host_are_restored() -> None:
    """A process that is not this program, and has called a command of it, goes on."""
    calls: list[str] = []
    before = {each: signal.signal(each, lambda *_: calls.append("host")) for each in END_SIGNALS}
    try:
        with call_on_end_signal(lambda: calls.append("stop")):
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    assert calls == ["stop", "host"]


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    """As nohup does with SIGHUP."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with call_on_end_signal(lambda: None) as handlers:
            os.kill(os.getpid(), signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert not handlers.received


def test_an_overdue_stop_is_ended_by_a_later_signal() -> None:
    done = subprocess.run([sys.executable, "-c", OVERDUE_STOP], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == -signal.SIGTERM
    assert done.stdout == "stopping\n"
    assert done.stderr == "\ngoniotwin: stopping\n"


def test_a_signal_at_the_very_end_of_the_process_leaves_its_exit_status() -> None:
    done = subprocess.run([sys.executable, "-c", LATE_SIGNAL], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 130
