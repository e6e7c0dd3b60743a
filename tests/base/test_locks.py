"""Lock files: one holder, freed by a kill."""

import subprocess
import sys
import threading

import pytest

from splatproof.base.errors import MissingError, UsageError
from splatproof.base.locks import locked

HOLDER = """
import sys, time
from pathlib import Path
from splatproof.base.locks import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_one_holder_and_the_others_are_told(tmp_path):
    path = tmp_path / "new" / ".lock"
    with (
        locked(path, busy="x"),
        pytest.raises(UsageError, match="in use"),
        locked(path, busy="in use"),
    ):
        pass
    with locked(path, busy="in use"):
        pass


def test_who_waits_gets_it_when_the_holder_is_killed(tmp_path):
    path = tmp_path / ".lock"
    got = threading.Event()

    def wait() -> None:
        with locked(path):
            got.set()

    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        waiting = threading.Thread(target=wait)
        waiting.start()
        assert not got.wait(0.2)
        holder.kill()
        assert got.wait(60)
        waiting.join()


def test_what_is_in_the_file_stays(tmp_path):
    (tmp_path / "record").write_text("kept")
    with locked(tmp_path / "record"):
        pass
    assert (tmp_path / "record").read_text() == "kept"


def test_where_no_file_can_be_made_a_user_is_told_what_to_do(tmp_path):
    (tmp_path / "file").write_text("")
    said = r"file/sub: cannot write here \(Not a directory\); go elsewhere"
    lock = locked(tmp_path / "file" / "sub" / ".lock", elsewhere="go elsewhere")
    with pytest.raises(MissingError, match=said), lock:
        pass
