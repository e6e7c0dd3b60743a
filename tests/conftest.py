"""Settings that all tests share."""

import os

from hypothesis import HealthCheck, settings

# This machine may be shared, so time is no reason to fail; CI draws the same examples each run.
settings.register_profile(
    "splatbench",
    deadline=None,
    derandomize=bool(os.environ.get("CI")),
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("splatbench")
