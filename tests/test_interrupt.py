"""A request to stop is noticed once, and what it replaced is restored."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from mesoshell.interrupt import StopRequest, arrived


def test_an_interrupt_that_arrived_is_not_raised_again() -> None:
    """By the main thread alone, which is where it is raised."""
    before = signal.signal(signal.SIGALRM, signal.SIG_IGN)
    try:
        signal.setitimer(signal.ITIMER_REAL, 100)
        with ThreadPoolExecutor(1) as other:
            other.submit(arrived).result()
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 0
        arrived()
        assert signal.getitimer(signal.ITIMER_REAL)[0] == 0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_a_second_interrupt_ends_a_run_at_once() -> None:
    with pytest.raises(KeyboardInterrupt), StopRequest() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.requested
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_program_that_calls_a_run_hears_its_signal_again() -> None:
    """When the context ends; in another thread there are no signals to be heard."""
    ended = False
    with pytest.raises(KeyboardInterrupt), StopRequest(again=True) as stop:
        os.kill(os.getpid(), signal.SIGINT)
        ended = stop.requested
    assert ended
    with StopRequest() as stop:
        os.kill(os.getpid(), signal.SIGINT)
    assert stop.requested

    def elsewhere() -> bool:
        with StopRequest(again=True) as stop:
            return stop.requested

    with ThreadPoolExecutor(1) as pool:
        assert not pool.submit(elsewhere).result()
