"""Settings that all tests share."""

import os

import torch
from hypothesis import HealthCheck, settings

# This machine may be shared, so time is no reason to fail; CI draws the same examples each run.
settings.register_profile(
    "splatproof",
    deadline=None,
    derandomize=bool(os.environ.get("CI")),
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("splatproof")

# Some of torch's warnings come once a process: then the order of tests decides which one fails.
torch.set_warn_always(True)
