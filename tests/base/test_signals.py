"""Signals that wait, and signals that native code may not keep."""

import os
import signal
import threading

import pytest

from splatproof.base.signals import ENDING, held_back, kept


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_waits_for_the_end_of_the_block(number):
    heard: list[int] = []
    before = signal.signal(number, lambda n, _: heard.append(n))
    try:
        with held_back():
            os.kill(os.getpid(), number)
            assert not heard
        assert heard == [number]
        assert signal.getsignal(number) is not before
        assert number not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    finally:
        signal.signal(number, before)


def test_ctrl_c_that_another_thread_is_given_waits_too():
    at_work, stop = threading.Event(), threading.Event()

    def idle() -> None:  # it does not block signals: the kernel may give it ctrl-C
        at_work.set()
        stop.wait()

    other = threading.Thread(target=idle)
    other.start()
    at_work.wait()
    done = False
    try:
        with pytest.raises(KeyboardInterrupt), held_back():  # noqa: PT012
            assert other.ident is not None
            signal.pthread_kill(other.ident, signal.SIGINT)
            stop.wait(0.2)
            done = True
    finally:
        stop.set()
        other.join()
    assert done


def test_outside_the_main_thread_nothing_is_lost():
    masks = []

    def work() -> None:
        with held_back():
            masks.append(signal.pthread_sigmask(signal.SIG_BLOCK, []))
        masks.append(signal.pthread_sigmask(signal.SIG_BLOCK, []))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert set(ENDING) <= masks[0]
    assert not set(ENDING) & masks[1]


def test_what_takes_a_signal_gives_it_back():
    heard: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda n, _: heard.append(n))
    try:
        with kept():
            # as native code does: Python still believes that its handler is in place
            import ctypes

            ctypes.CDLL(None).signal(int(signal.SIGTERM), ctypes.c_void_p(1))  # SIG_IGN
            os.kill(os.getpid(), signal.SIGTERM)
            assert not heard
        os.kill(os.getpid(), signal.SIGTERM)
        assert heard == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)
