"""Workers: what they say, how they end, and ctrl-C at any moment of their start."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from helpers.talking_workers import die, echo, tell_quiet, tell_variable
from splatproof.base.processes import Worker, how_it_ended, listening
from splatproof.base.quiet import silenced


@pytest.mark.parametrize("preload", [(), ("splatproof.base.errors",)])
def test_what_is_said_comes_back(preload):
    with Worker(echo, "hello", preload=preload) as worker:
        assert worker.pid != os.getpid()
        assert worker.receive() == "hello"
        worker.send({"a": [1]})
        assert listening([worker]) == [worker]
        assert worker.receive() == {"a": [1]}
        worker.send("end")
        with pytest.raises(EOFError):
            worker.receive()
        assert worker.how_it_ended() == "ended with exit code 0"


@pytest.mark.parametrize("quiet", [True, False])
@pytest.mark.parametrize("preload", [(), ("splatproof.base.errors",)])
def test_a_worker_is_as_quiet_as_the_one_that_starts_it(quiet, preload):
    with silenced(quiet), Worker(tell_quiet, preload=preload) as worker:
        assert worker.receive() is quiet


@pytest.mark.parametrize("preload", [(), ("splatproof.base.errors",)])
def test_a_worker_has_the_environment_of_its_own_start(preload, monkeypatch):
    for value in ("first", "second"):
        monkeypatch.setenv("SPLATPROOF_OF_A_TEST", value)
        with Worker(tell_variable, "SPLATPROOF_OF_A_TEST", preload=preload) as worker:
            assert worker.receive() == value
    monkeypatch.delenv("SPLATPROOF_OF_A_TEST")
    with Worker(tell_variable, "SPLATPROOF_OF_A_TEST", preload=preload) as worker:
        assert worker.receive() is None


@pytest.mark.parametrize(("code", "how"), [(7, "exit code 7"), (-signal.SIGTERM, "by SIGTERM")])
def test_a_death_without_a_word_is_told(code, how):
    with Worker(die, code) as worker:
        with pytest.raises(EOFError):
            worker.receive()
        assert how in worker.how_it_ended()
        with pytest.raises(EOFError):
            worker.send("more")


def test_running_out_of_memory_is_guessed():
    assert "running out of memory" in how_it_ended(-signal.SIGKILL)


def test_the_block_ends_the_worker():
    with Worker(echo, "hello") as worker:
        worker.receive()
        pid = worker.pid
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_what_cannot_be_sent_starts_nothing():
    with pytest.raises(AttributeError):
        Worker(echo, lambda: None)


BUSY = """
import os
def work(says):
    says.send(os.getpid())
    sum(range(10**12))  # holds the interpreter, as native code may: no thread of Python's gets a turn
"""
PARENT = """
import sys, threading
from splatproof.base.processes import Worker
from busy import work

if __name__ == "__main__":
    worker = []
    def start():
        worker.append(Worker(work, preload=["busy"] if sys.argv[1] == "preload" else []))
    starter = threading.Thread(target=start)  # a worker outlives the thread that started it
    starter.start()
    starter.join()
    print(worker[0].receive(), flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's help is Linux's")
@pytest.mark.parametrize("how", ["spawn", "preload"])
def test_a_worker_that_is_busy_ends_with_its_parent_at_once(tmp_path, how):
    (tmp_path / "busy.py").write_text(BUSY)
    (tmp_path / "parent.py").write_text(PARENT)
    with subprocess.Popen(
        [sys.executable, "parent.py", how], cwd=tmp_path, stdout=subprocess.PIPE,
        stdin=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": str(tmp_path)},
    ) as parent:  # fmt: skip
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        time.sleep(0.3)
        os.kill(worker, 0)  # it lives
        parent.kill()
    deadline = time.monotonic() + 2
    while Path(f"/proc/{worker}").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    left = Path(f"/proc/{worker}").exists()
    if left:
        os.kill(worker, signal.SIGKILL)
    assert not left


LONG = """
import os
from pathlib import Path
Path("server").write_text(str(os.getpid()))
sum(range(10**10))  # as torch's import, which holds the interpreter too
def work(says):
    pass
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's help is Linux's")
def test_a_fork_server_that_is_importing_ends_with_its_parent_at_once(tmp_path):
    (tmp_path / "long.py").write_text(LONG)
    start = "from splatproof.base.processes import Worker; Worker(print, preload=['long'])"
    with subprocess.Popen(
        [sys.executable, "-c", start], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(tmp_path)}
    ) as parent:
        note = tmp_path / "server"
        until(lambda: note.exists() and note.read_text() != "", 30)
        server = int(note.read_text())
        parent.kill()
    try:
        until(lambda: not Path(f"/proc/{server}").exists(), 2)
    finally:
        with suppress(ProcessLookupError):
            os.kill(server, signal.SIGKILL)


def until(holds: Callable[[], bool], seconds: float) -> None:
    """Wait until something holds."""
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


SLOW = """
import time
time.sleep(0.3)  # as torch: a signal may come while this is imported
def work(says):
    says.send("ready")
    time.sleep(600)
"""
STARTS = """
import signal, sys
from splatproof.base.processes import Worker
from slow import work

def end(*_):
    raise KeyboardInterrupt

if __name__ == "__main__":
    signal.signal(signal.SIGTERM, end)
    try:
        print("starting", flush=True)
        with Worker(work, preload=["slow"] if sys.argv[1] == "preload" else []) as worker:
            worker.receive()
            print("ready", flush=True)
            worker.receive()
    except KeyboardInterrupt:
        print("ended", file=sys.stderr)
        sys.exit(130)
"""
MOMENTS = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.45, 0.6, 1.0)
"""Seconds after the start begins; a worker here is ready after about 0.5 to 1."""


@pytest.mark.parametrize(
    ("how", "number"),
    [
        ("spawn", signal.SIGINT), ("preload", signal.SIGINT), ("preload", signal.SIGTERM),
        pytest.param("spawn", signal.SIGTERM, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_ctrl_c_at_any_moment_of_a_start_is_one_line(tmp_path, number, how):
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "starts.py").write_text(STARTS)
    with ThreadPoolExecutor(4) as pool:
        said = list(pool.map(partial(_interrupted, tmp_path, number, how), MOMENTS))
    ready = sum("ready" in words for words in said)
    # else the moments lie before or after the start, not in it
    assert ready < len(MOMENTS)


def _interrupted(folder: Path, number: signal.Signals, how: str, moment: float) -> str:
    """What starts.py prints when all its processes get the signal so long after "starting"."""
    process = subprocess.Popen(
        [sys.executable, "starts.py", how], cwd=folder, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(folder)},
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == "starting\n"
    time.sleep(moment)
    os.killpg(process.pid, number)
    said, errors = process.communicate(timeout=60)
    assert errors == "ended\n", f"{number.name} after {moment} s"
    assert process.returncode == 130
    return said
