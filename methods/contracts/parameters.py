"""The tensors of a model that is trained, in groups, and how density control reorders them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Int
from torch import Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Edit:
    """How the rows of a model change: which stay, which are copied, which are made."""

    parents: Int[Tensor, " m"] | None = None
    """Old row that each new row descends from; None: rows stay as they are."""
    fresh: Bool[Tensor, " m"] | None = None
    """New rows whose moments start at zero; None: none of them."""
    values: Mapping[str, Tensor] = field(default_factory=dict)
    """New values of whole tensors (trained ones of rows, or labels), in the new order."""
    forget: frozenset[str] = frozenset()
    """Tensors whose moments start again at zero in every row."""


class Parameters:
    """Named tensors: of rows, shared by all rows, and labels of rows that nothing trains."""

    def __init__(
        self,
        rows: Mapping[str, Tensor],
        *,
        shared: Mapping[str, Tensor] | None = None,
        labels: Mapping[str, Tensor] | None = None,
    ) -> None:
        """Take copies of the tensors.

        Args:
            rows: Trained, one entry a Gaussian or anchor; an edit reorders them, moments included.
            shared: Trained, never reordered: networks, skies, exposures.
            labels: Not trained, one entry a row, reordered with them: roles, levels.

        Raises: ValueError if a name is there twice or the rows disagree in number.
        """
        self.rows = {name: _own(value) for name, value in rows.items()}
        self.shared = {name: _own(value) for name, value in (shared or {}).items()}
        self.labels = {name: _own(value) for name, value in (labels or {}).items()}
        names = [*self.rows, *self.shared, *self.labels]
        if len(set(names)) < len(names):
            raise ValueError(f"a name is there twice: {sorted(names)}")
        counts = {name: len(value) for name, value in (self.rows | self.labels).items()}
        if len(set(counts.values())) > 1:
            raise ValueError(f"rows disagree in number: {counts}")

    @staticmethod
    def of(state: Mapping[str, Tensor]) -> "Parameters":
        """The parameters that `state` was asked of.

        Args:
            state: Every tensor by group and name, as `state` returns them.

        Raises: KeyError for a name of no group; ValueError as for the parameters themselves.
        """
        groups: dict[str, dict[str, Tensor]] = {"rows": {}, "shared": {}, "labels": {}}
        for name, value in state.items():
            group, _, rest = name.partition(".")
            groups[group][rest] = value
        return Parameters(groups["rows"], shared=groups["shared"], labels=groups["labels"])

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.rows.values()), ()))

    @property
    def trained(self) -> dict[str, Tensor]:
        """All tensors that an optimiser may move, by name."""
        return self.rows | self.shared

    def to(self, device: torch.device) -> None:
        """Move every tensor to a device."""
        for group in (self.rows, self.shared, self.labels):
            for name, value in group.items():
                group[name] = value.detach().to(device)

    @torch.no_grad()
    def edit(self, edit: Edit) -> None:
        """Reorder the rows and take over new values; shared tensors stay as they are."""
        for group in (self.rows, self.labels):
            for name, value in group.items():
                if edit.parents is not None:
                    value = value.detach()[edit.parents]
                if name in edit.values:
                    value = _own(edit.values[name])
                group[name] = value

    def state(self) -> dict[str, Tensor]:
        """Every tensor by group and name, for checkpoints and models on disk."""
        groups = {"rows": self.rows, "shared": self.shared, "labels": self.labels}
        return {
            f"{group}.{name}": value.detach()
            for group, tensors in groups.items()
            for name, value in tensors.items()
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take over what `state` returned; tensors stay on their devices."""
        groups = {"rows": self.rows, "shared": self.shared, "labels": self.labels}
        for group, tensors in groups.items():
            for name, value in tensors.items():
                tensors[name] = state[f"{group}.{name}"].clone().to(value.device)


def _own(value: Tensor) -> Tensor:
    return value.detach().clone().contiguous()
