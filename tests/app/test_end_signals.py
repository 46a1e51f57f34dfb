"""Requests to end, where something other than a KeyboardInterrupt answers the first."""

import os
import signal
import subprocess
import sys

import pytest

from goniotwin.app.end_signals import REQUESTS, requests_to_end_call

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="this system sends no signals to a process")
PATIENCE = """
import signal
from goniotwin.app import end_signals as ending

ending.LONGEST_S = 0.0
with ending.requests_to_end_call(lambda: print("stopping", flush=True)):
    while True:
        signal.raise_signal(signal.SIGTERM)
"""


def test_without_a_request_the_handlers_are_restored() -> None:
    before = [signal.getsignal(number) for number in REQUESTS]
    with requests_to_end_call(lambda: None) as requests:
        assert all(signal.getsignal(number) == requests.first for number in REQUESTS)
    assert [signal.getsignal(number) for number in REQUESTS] == before
    assert not requests.came


@pytest.mark.parametrize("number", REQUESTS)
def test_the_first_request_calls_and_further_ones_are_ignored_from_then_on(number: int) -> None:
    before = {each: signal.getsignal(each) for each in REQUESTS}
    calls: list[str] = []
    try:
        with requests_to_end_call(lambda: calls.append("stop")) as requests:
            os.kill(os.getpid(), number)
            for each in (*REQUESTS, number):
                os.kill(os.getpid(), each)
        for each in REQUESTS:  # a program that closes its files now is not broken off
            os.kill(os.getpid(), each)
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    assert calls == ["stop"]
    assert requests.came


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    """As nohup does with SIGHUP."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with requests_to_end_call(lambda: None) as requests:
            os.kill(os.getpid(), signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert not requests.came


def test_a_stop_that_takes_too_long_is_broken_off_by_a_further_request() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PATIENCE], capture_output=True, text=True, timeout=300, check=False
    )  # fmt: skip
    assert done.returncode == -signal.SIGTERM
    assert done.stdout == "stopping\n"
    assert done.stderr == "\ngoniotwin: stopping\n"
