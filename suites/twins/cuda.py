"""Twins on a GPU: our adapter to gsplat, and gsplat's own call with the same numbers."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.contracts import cuda_gsplat
from splatproof.suites.twins.rasterizers import PIPELINE, RASTERIZER, draws, pipes
from splatproof.suites.twins.twin import Component, Forward, Leaves, Problem, Twin, functional

GIVES_UP = "gsplat's own early stop, alpha cap and arithmetic"
MEBIBYTE = 2**20


def with_cuda(component: Component) -> Component:
    """The component with its twins on the GPU added, if it has such."""
    if component.name == RASTERIZER.name:
        made = (draws(cuda_gsplat.rasterize), functional(own_call))
    elif component.name == PIPELINE.name:
        made = (pipes(cuda_gsplat.rasterize), functional(own_pipeline))
    else:
        return component
    twins = tuple(
        Twin(name=name, start=on_device(start), approximates=GIVES_UP, finish=synchronise,
             device_mb=device_mb)
        for name, start in zip(("cuda adapter", "gsplat's own call"), made, strict=True)
    )  # fmt: skip
    return replace(component, twins=(*component.twins, *twins))


def on_device(start: Callable[[Problem, Leaves], Forward]) -> Callable[[Problem, Leaves], Forward]:
    """The same `start` with leaves that live on the GPU."""

    def moved(problem: Problem, leaves: Leaves) -> Forward:
        for name, leaf in leaves.items():
            leaves[name] = leaf.detach().to(cuda_gsplat.gpu()).requires_grad_(leaf.requires_grad)
        return start(problem, leaves)

    return moved


def own_call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """gsplat's documented call with nothing of ours around it.

    Args:
        leaves: Inputs by name; outputs depend on them.
        given: Everything else of the problem, by name.
    """
    means = leaves["means"]
    camera = given["camera"]
    image, _, _ = importlib.import_module("gsplat").rasterization(
        means, leaves["quaternions"], leaves["scales"], leaves["opacities"], leaves["sh"],
        camera.world_to_camera.to(means)[None], camera.K.to(means)[None], camera.width,
        camera.height, near_plane=camera.near, sh_degree=3, packed=False, render_mode="RGB",
    )  # fmt: skip
    return image[0]


def own_pipeline(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The same behind the activations of the trained parameters.

    Args:
        leaves: Inputs by name; outputs depend on them.
        given: Everything else of the problem, by name.
    """
    activated = dict(leaves)
    activated["scales"] = leaves["log_scales"].exp()
    activated["opacities"] = leaves["opacity_logits"].sigmoid()
    return own_call(activated, given)


def synchronise() -> None:
    """Wait for the GPU."""
    if cuda_gsplat.gpu().type == "cuda":
        torch.cuda.synchronize()


def device_mb() -> float:
    """Peak of the memory that torch has taken on the GPU, in 2^20 bytes."""
    return torch.cuda.max_memory_allocated() / MEBIBYTE
