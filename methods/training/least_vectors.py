"""The homogeneous equations of many matches solved at once: a faster twin of the reference's SVD."""

from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor

ROUNDS = 3
"""Steps of the iteration. An error falls by the ratio of the two smallest squared singular values each
time, which is 1e-3 and less for rays that come within a pixel of one another."""
PAIRS = tuple(combinations(range(4), 2))
"""Pairs of rows, and of columns, in the order of the 2 x 2 minors below."""


def least_vectors(systems: Float[Tensor, "n 4 4"]) -> Float[Tensor, "n 4"]:
    """Unit vectors h that make |A h| least, of either sign.

    Inverse iteration on A^T A. Its inverse is known up to a factor without a division, as the matrix of
    cofactors, which for an exact match is h h^T but for a factor: one step then is enough, and a singular
    system is no special case.

    Args:
        systems: Homogeneous equations A, float64, one a row. Two singular values of nearly the same
            size leave the vector undecided, as they do in an SVD.

    Source: inverse iteration: Golub and Van Loan, "Matrix Computations", Sec. 8.2; cofactors by Laplace
        expansion; together ours. Twin of `reference.supervision.dense_initialisation.least_vectors`.
    """
    square = systems.transpose(1, 2) @ systems
    size = square.diagonal(dim1=1, dim2=2).sum(dim=1).clamp(min=torch.finfo(square.dtype).tiny)
    cofactors = _cofactors((square / size[:, None, None]).permute(1, 2, 0).contiguous())
    # the column with the largest diagonal cofactor is never orthogonal to what is looked for
    best = cofactors.diagonal(dim1=0, dim2=1).argmax(dim=1)
    found = cofactors[:, best, torch.arange(len(best))]
    for _ in range(ROUNDS):
        found = found / found.abs().amax(dim=0).clamp(min=torch.finfo(found.dtype).tiny)
        found = (cofactors * found).sum(dim=1)
    return torch.nn.functional.normalize(found.T, dim=1, eps=torch.finfo(found.dtype).tiny)


def _cofactors(square: Float[Tensor, "4 4 n"]) -> Float[Tensor, "4 4 n"]:
    """Cofactors of symmetric matrices, by the 2 x 2 minors of the upper and the lower two rows."""
    s0, s1, s2, s3, s4, s5 = (
        square[0, i] * square[1, j] - square[1, i] * square[0, j] for i, j in PAIRS
    )
    c1, c2, c3, c4, c5 = (
        square[2, i] * square[3, j] - square[3, i] * square[2, j] for i, j in PAIRS[1:]
    )
    m = square
    upper = {
        (0, 0): m[1, 1] * c5 - m[1, 2] * c4 + m[1, 3] * c3,
        (0, 1): -m[0, 1] * c5 + m[0, 2] * c4 - m[0, 3] * c3,
        (0, 2): m[3, 1] * s5 - m[3, 2] * s4 + m[3, 3] * s3,
        (0, 3): -m[2, 1] * s5 + m[2, 2] * s4 - m[2, 3] * s3,
        (1, 1): m[0, 0] * c5 - m[0, 2] * c2 + m[0, 3] * c1,
        (1, 2): -m[3, 0] * s5 + m[3, 2] * s2 - m[3, 3] * s1,
        (1, 3): m[2, 0] * s5 - m[2, 2] * s2 + m[2, 3] * s1,
        (2, 2): m[3, 0] * s4 - m[3, 1] * s2 + m[3, 3] * s0,
        (2, 3): -m[2, 0] * s4 + m[2, 1] * s2 - m[2, 3] * s0,
        (3, 3): m[2, 0] * s3 - m[2, 1] * s1 + m[2, 2] * s0,
    }
    return torch.stack([
        torch.stack([upper[min(i, j), max(i, j)] for j in range(4)]) for i in range(4)
    ])  # fmt: skip
