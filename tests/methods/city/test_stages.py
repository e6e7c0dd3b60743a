"""What stages say of the memory that they took."""

import pytest

from splatproof.methods.city.stages import Stages


@pytest.mark.parametrize(
    ("told", "known"),
    [({}, True), ({"peak_mb": 1e6}, True), ({"peak_mb": 0.0}, False), (None, True)],
)
def test_the_largest_process_counts_and_what_nobody_said_is_not_known(tmp_path, told, known):
    stages = Stages(tmp_path, "key", lambda name, seconds: None)
    stages.run("blocks", lambda: told)
    again = Stages(tmp_path, "key", lambda name, seconds: None)
    assert again.peak_mb == stages.peak_mb
    assert set(stages.peak_mb) == ({"blocks"} if known else set())
    if told and known:
        assert stages.peak_mb["blocks"] == 1e6
