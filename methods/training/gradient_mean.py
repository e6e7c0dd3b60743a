"""Several views, one step: the mean of what each says about the parameters."""

from collections.abc import Mapping

from torch import Tensor


class GradientMean:
    """Collects gradients of one backward pass after the other."""

    def __init__(self) -> None:
        """Start with no pass."""
        self._sums: dict[str, Tensor] = {}
        self._passes = 0

    def take(self, parameters: Mapping[str, Tensor]) -> None:
        """Move the .grad of the parameters into the sum; a parameter without one adds zero."""
        self._passes += 1
        for name, value in parameters.items():
            if value.grad is not None:
                held = self._sums.get(name)
                self._sums[name] = value.grad.clone() if held is None else held.add_(value.grad)
                value.grad = None

    def leave(self, parameters: Mapping[str, Tensor]) -> None:
        """Leave the mean over the passes as the parameters' .grad."""
        for name, total in self._sums.items():
            parameters[name].grad = total.div_(self._passes)
