"""Peak memory of a process of its own."""

import subprocess
import sys

from splatproof.base.memory import peak_memory_mb


def test_peak_memory_sees_an_allocation_and_not_the_parents():
    program = (
        "from splatproof.base.memory import peak_memory_mb as peak\n"
        "before = peak(); block = bytearray(200 * 2**20); print(before, peak())"
    )
    held = bytearray(600 * 2**20)  # a child's ru_maxrss would start at our peak
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    before, after = map(float, done.stdout.split())
    assert 150 < after - before < 300
    assert peak_memory_mb() > len(held) / 2**20 > before + 100
