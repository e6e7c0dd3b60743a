"""Scenes: adapters for data sets and photos, procedural scenes with known truth, the registry."""

import signal
import threading

import pycolmap  # noqa: F401

# pycolmap's log takes SIGTERM and prints a stack trace; give it back to whoever had it.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
