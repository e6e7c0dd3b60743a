"""Imported by a fork server before all else that it imports ahead: it ends with who started it, its libraries'
threads sleep while they wait, and no garbage is looked for while it imports: that is a tenth of the time."""

import gc

from splatproof.base.idle_threads import wait_asleep
from splatproof.base.leash import take_offered

take_offered()
wait_asleep()
gc.disable()  # a worker enables it (splatproof.base.processes)
