"""Imported by a fork server before all else that it imports ahead: it ends with who started it, and its
libraries' threads sleep while they wait."""

from splatproof.base.idle_threads import wait_asleep
from splatproof.base.leash import take_offered

take_offered()
wait_asleep()
