"""Imported by a fork server before all else that it imports ahead: it ends with who started it."""

from splatproof.base.leash import take_offered

take_offered()
