"""A small network that tells crops where blocks meet from others."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

TRAINING = 600
"""Steps of its training."""
BATCH = 64
RATE = 1e-3
DECAY = 1e-2
"""Weight decay of AdamW."""
Crops = Float[Tensor, "n 3 s s"]


class SeamNetwork(nn.Module):
    """Three convolutions, mean and maximum over the crop, one linear layer: 15,000 weights."""

    def __init__(self) -> None:
        """Draw the weights from torch's generator."""
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(3, 16, 5, stride=2, padding=2), nn.ReLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1), nn.ReLU(),
            nn.Conv2d(32, 32, 3, padding=1), nn.ReLU(),
        )  # fmt: skip
        self.last = nn.Linear(64, 1)

    def forward(self, crops: Crops) -> Float[Tensor, " n"]:
        """The logit that blocks meet in each crop, whatever its mean colour.

        Args:
            crops: In [0, 1].
        """
        own = crops - crops.mean(dim=(2, 3), keepdim=True)
        found = self.layers(4 * own)
        return self.last(torch.cat([found.mean(dim=(2, 3)), found.amax(dim=(2, 3))], dim=1))[:, 0]


def trained(crops: Crops, seams: Bool[Tensor, " n"], *, steps: int, seed: int) -> SeamNetwork:
    """The network after so many batches, each crop turned and mirrored at random.

    Args:
        crops: In [0, 1].
        seams: Whether blocks meet in each.
        steps: Number of batches, at least 1.
        seed: Seed of its weights, batches and turns.
    """
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(seed)
        network = SeamNetwork()
        optimizer = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY)
        fall = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        for _ in range(steps):
            rows = torch.randint(len(crops), (BATCH,))
            turned = torch.rot90(crops[rows], int(torch.randint(4, ())), dims=(2, 3))
            if bool(torch.rand(()) < 0.5):
                turned = turned.flip(dims=(3,))
            loss = functional.binary_cross_entropy_with_logits(network(turned), seams[rows].float())
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            fall.step()
    return network.eval()


@torch.no_grad()
def chance(network: SeamNetwork, crops: Crops) -> Float[Tensor, " n"]:
    """How likely the network calls each crop one of a seam, in [0, 1].

    Args:
        network: The trained network.
        crops: In [0, 1].
    """
    parts = [network(part).sigmoid() for part in crops.split(1024)]
    return torch.cat(parts) if parts else torch.zeros(0)
