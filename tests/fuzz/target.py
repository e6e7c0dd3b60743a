"""What is fuzzed: a kind of file, how it is damaged, and the reader that must stand it."""

import functools
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fuzz.layout import Layout


@dataclass(frozen=True, kw_only=True)
class Target:
    """A kind of file and the door at which it is read."""

    path: Path
    """Where an input is put; files that belong to it lie there intact."""
    samples: Sequence[bytes]
    """Intact files, small ones, by the project's own writers."""
    layout: Layout
    read: Callable[[Path], object]
    """Reads the file; what it returns must be finite in every number."""
    finite: bool = True
    """Whether no number of what is read may be NaN or infinite; False where the format allows it."""
    named: bool = True
    """Whether an error says the file's name."""
    room: Callable[[bytes], int] = lambda data: 0
    """Bytes of memory that an input may take beside the bounds that all have."""
    prepare: Callable[[Path], None] | None = None
    """Called when the file was written: makes right what others say of it, such as a checksum."""

    def input(self, name: str, number: int) -> bytes:
        """The input of that number: the same on every machine that writes the same samples.

        Args:
            name: Name of the target.
            number: From 0; the first ones are the samples themselves, then comes what once failed.
        """
        if number < len(self.samples):
            return self.layout.intact(self.samples[number])
        failed = failures(name)
        if number < len(self.samples) + len(failed):
            return failed[number - len(self.samples)].read_bytes()
        draw = random.Random(f"{name} {number}")
        return self.layout.changed(draw, draw.choice(self.samples), self.samples)


CORPUS = Path(__file__).parent / "corpus"
"""Inputs that once failed, in a folder a target; reasons.toml says of each what was wrong."""


@functools.cache
def failures(name: str) -> list[Path]:
    """Files of the corpus that belong to a target, sorted.

    Args:
        name: Name of the target.
    """
    return sorted((CORPUS / slug(name)).glob("*"))


def slug(name: str) -> str:
    """Folder of a target in the corpus.

    Args:
        name: Name of the target.
    """
    return name.replace(" ", "-")
