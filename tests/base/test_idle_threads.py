"""Libraries leave cores to others, in workers of whoever starts them."""

import os
import subprocess
import sys

import pytest

from splatproof.base.idle_threads import ASLEEP

SEEN = """
import scipy.linalg, threadpoolctl

def told(says):
    pools = threadpoolctl.threadpool_info()
    says.send({pool["num_threads"] for pool in pools if pool["user_api"] == "blas"})
"""
STARTS = """
from splatproof.base.processes import Worker
from seen import told

if __name__ == "__main__":
    with Worker(told, preload=("seen",)) as worker:
        print(worker.receive())
"""


@pytest.mark.parametrize(("given", "threads"), [({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, 2)])
def test_a_workers_libraries_leave_cores_to_others_unless_the_user_says_otherwise(
    tmp_path, given, threads
):
    (tmp_path / "seen.py").write_text(SEEN)
    (tmp_path / "starts.py").write_text(STARTS)
    plain = {k: v for k, v in os.environ.items() if not k.startswith(("OMP", *ASLEEP))}
    environment = plain | given | {"PYTHONPATH": str(tmp_path)}
    said = subprocess.run(
        [sys.executable, "starts.py"], cwd=tmp_path, env=environment, text=True, check=True,
        capture_output=True,
    ).stdout.strip()  # fmt: skip
    assert said == str({min(threads, os.cpu_count() or 1)})
