"""How a file is taken apart into what a reader trusts, damaged, and put together again."""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fuzz.mutations import Change, changed_bytes, changed_json, changed_text

Part = tuple[Change, bytes]
"""How a part of a file is changed, and the part."""
WHOLE = 0.15
"""Share of inputs in which the finished file is changed once more, lengths and checksums with it."""


@dataclass(frozen=True)
class Layout:
    """How a kind of file is taken apart and put together."""

    split: Callable[[bytes], list[Part]]
    join: Callable[[list[bytes]], bytes]

    def intact(self, sample: bytes) -> bytes:
        """A sample taken apart and put together with no change.

        Args:
            sample: What `split` takes.
        """
        return self.join([content for _, content in self.split(sample)])

    def changed(self, draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
        """A file with one or two of its parts changed.

        Args:
            draw: Where chance comes from.
            data: An intact file of this layout.
            others: Intact files, for spans.
        """
        parts = self.split(data)
        contents = [content for _, content in parts]
        for _ in range(draw.choice((1, 1, 1, 2))):
            place = draw.randrange(len(parts))
            change = parts[place][0]
            spans = [contents[place], draw.choice(contents), draw.choice(others)]
            contents[place] = change(draw, contents[place], spans)
        if len(parts) > 1 and draw.random() < 0.03:
            draw.shuffle(contents)
        data = self.join(contents)
        return changed_bytes(draw, data, [data, *others]) if draw.random() < WHOLE else data


def _one(change: Change) -> Layout:
    return Layout(lambda data: [(change, data)], lambda contents: contents[0])


BINARY, TEXT, JSON = _one(changed_bytes), _one(changed_text), _one(changed_json)
