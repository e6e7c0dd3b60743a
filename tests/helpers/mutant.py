"""A pytest plugin that replaces one module by a faulty copy: are the tests able to see it?

Read by `pytest -p helpers.mutant` with SPLATPROOF_MUTANT="splatproof.reference.x=/path/to/x.py".
"""

import importlib.abc
import importlib.util
import os
import sys

NAME, _, PATH = os.environ.get("SPLATPROOF_MUTANT", "").partition("=")


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the mutated module before anything else does."""

    def find_spec(self, fullname, path=None, target=None):
        if fullname != NAME:
            return None
        return importlib.util.spec_from_file_location(fullname, PATH)


if NAME:
    sys.meta_path.insert(0, _Finder())
