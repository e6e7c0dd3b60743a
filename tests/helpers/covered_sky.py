"""How a learnt sky is taught by what does not cover it."""

import pytest
import torch

from splatproof.methods.contracts.model import Model
from splatproof.methods.dynamic.sky import SKY
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View


def require_taught_below(model: Model, view: View, covered: float) -> None:
    """The sky's texels get what shines through pixels whose alpha is below `covered`, and nothing else."""
    height, width = view.size
    alpha = torch.linspace(0, 1, height * width).reshape(height, width)
    cube = model.parameters.shared[SKY].requires_grad_()
    output = RenderOutput(
        colour=torch.zeros(height, width, 3), alpha=alpha, depth=alpha, radii=torch.zeros(0)
    )
    model.finish_image(view, output).sum().backward()
    assert cube.grad is not None
    left = (1 - alpha)[alpha < covered].sum()
    assert float(cube.grad.sum()) == pytest.approx(3 * float(left), rel=1e-5)
