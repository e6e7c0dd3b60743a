"""How much work a training was, in numbers that no other load on the machine changes."""

from dataclasses import asdict, dataclass, replace

import torch

from splatproof.methods.contracts.parameters import Edit


@dataclass(frozen=True, kw_only=True)
class Counts:
    """What one training did so far; the same for the same seed, code and kernels."""

    steps: int = 0
    """Training steps."""
    pairs: int = 0
    """Pairs of Gaussian and tile that were sorted and blended; 0 where the backend does not count."""
    densifications: int = 0
    """Times that density control changed which rows there are."""
    rows_added: int = 0
    """Rows that started with zero moments: clones, children of splits, new anchors."""
    rows_removed: int = 0
    """Rows that no later row continues: those that were split, and those that were pruned."""
    resets: int = 0
    """Times that a tensor's moments were forgotten in every row, as after an opacity reset."""

    def after_step(self, pairs: int) -> "Counts":
        """One step more.

        Args:
            pairs: Pairs of its views.
        """
        return replace(self, steps=self.steps + 1, pairs=self.pairs + pairs)

    def after_edit(self, edit: Edit, rows: int) -> "Counts":
        """One change by density control more.

        Args:
            edit: The change.
            rows: Number of rows before it.
        """
        counts = replace(self, resets=self.resets + bool(edit.forget))
        if edit.parents is None:
            return counts
        fresh = edit.fresh
        if fresh is None:
            fresh = torch.zeros(len(edit.parents), dtype=torch.bool, device=edit.parents.device)
        continued = len(edit.parents[~fresh].unique())
        return replace(
            counts,
            densifications=self.densifications + 1,
            rows_added=self.rows_added + int(fresh.sum()),
            rows_removed=self.rows_removed + rows - continued,
        )

    def named(self) -> dict[str, int]:
        """The numbers by name, for a record."""
        return asdict(self)
