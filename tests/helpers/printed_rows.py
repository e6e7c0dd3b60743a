"""What a command of the face prints for machines."""

import json

import pytest

from splatproof.cli import main


def rows_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> list[dict]:
    """What a command that succeeds prints for machines."""
    assert main([*arguments, "--json", "--quiet"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]
