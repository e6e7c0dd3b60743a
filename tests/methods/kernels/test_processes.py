"""Forks and many workers: no hang, no threads that nobody asked for."""

import os
import subprocess
import sys

import pytest

PRELUDE = """
import os, sys, torch
sys.path.insert(0, sys.argv[1])
from splatproof import _ext
from splatproof.methods.kernels.rasterizer import rasterize
from splatproof.suites.hard_cases.gaussian_scenes import random_scene
scene = random_scene(600, 3, width=130, height=70)
values = [v.detach() for v in scene.arguments(torch.float32)]
def draw():
    return rasterize(scene.camera, *values[:4], sh=values[4]).colour
def tasks():
    return len(os.listdir("/proc/self/task"))
"""
FORK = (
    PRELUDE
    + """
import threading
torch.set_num_threads(2)
here = draw()
stop = threading.Event()
def keep_drawing():
    while not stop.is_set():
        draw()
busy = threading.Thread(target=keep_drawing)
busy.start()  # so that forks come while locks are held
try:
    for _ in range(12):
        child = os.fork()
        if child == 0:
            os._exit(0 if torch.equal(draw(), here) else 1)
        _, status = os.waitpid(child, 0)
        assert status == 0, status
finally:
    stop.set()
    busy.join()
assert torch.equal(draw(), here)
"""
)
ONE_THREAD = (
    PRELUDE
    + """
before = tasks()
draw()
assert _ext.threads() == torch.get_num_threads() == 1, _ext.threads()
assert tasks() == before, (before, tasks())
torch.set_num_threads(2)
before = tasks()  # torch's own came
draw()
assert tasks() == before + 1, (before, tasks())
torch.set_num_threads(1)
draw()
assert _ext.threads() == 1
"""
)


def python(code: str, **environment: str) -> subprocess.Popen[bytes]:
    tests = os.path.dirname(os.path.dirname(os.path.dirname(__file__)))
    return subprocess.Popen([sys.executable, "-P", "-c", code, tests], env=os.environ | environment)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_child_draws_the_same_picture():
    process = python(FORK)
    try:
        assert process.wait(timeout=100) == 0
    finally:
        process.kill()


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="threads are counted in /proc")
def test_workers_of_one_thread_start_no_others():
    workers = [python(ONE_THREAD, OMP_NUM_THREADS="1") for _ in range(2)]
    try:
        assert [worker.wait(timeout=100) for worker in workers] == [0, 0]
    finally:
        for worker in workers:
            worker.kill()
