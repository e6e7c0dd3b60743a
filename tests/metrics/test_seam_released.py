"""The released family of seam metrics against direct formulas."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import sobel
from scipy.spatial.transform import Rotation

from helpers.images import noise_image, random_mask
from helpers.tiny_scene import camera
from splatproof.base.errors import DataError
from splatproof.metrics.seam import SeamScores
from splatproof.metrics.seam_released import (
    NAMES,
    back_project,
    seam_mask_released,
    seam_scores_released,
    seam_view_released,
    sobel_magnitude,
)
from splatproof.reference.partition.boxes import OrientedBox
from splatproof.reference.types.camera import project_points


def turned_camera(index, **size):
    """A camera of the row, pitched and rolled, so that a rotation is not its transpose."""
    where = camera(index, **size)
    pose = where.world_to_camera.clone()
    angles = torch.tensor([0.2, -0.15, 0.3])
    pose[:3, :3] = torch.from_numpy(Rotation.from_euler("xyz", angles.numpy()).as_matrix())
    return dataclasses.replace(where, world_to_camera=pose)


def box(centre, half, degrees=0.0):
    turn = math.radians(degrees)
    rotation = torch.tensor(
        [
            [math.cos(turn), math.sin(turn), 0.0],
            [-math.sin(turn), math.cos(turn), 0.0],
            [0.0, 0.0, 1.0],
        ],
        dtype=torch.float64,
    )
    return OrientedBox(
        centre=torch.tensor(centre, dtype=torch.float64),
        rotation=rotation,
        half=torch.tensor(half, dtype=torch.float64),
    )


@settings(max_examples=20)
@given(st.integers(0, 5), st.integers(0, 99))
def test_back_projected_points_project_to_their_pixels(index, seed):
    where = turned_camera(index, width=7, height=5)
    depth = 0.5 + noise_image(5, 7, seed)[..., 0].double() * 9
    pixels, z = project_points(where, back_project(depth, where).reshape(-1, 3))
    rows, columns = torch.meshgrid(torch.arange(5), torch.arange(7), indexing="ij")
    want = torch.stack([columns, rows], dim=2).reshape(-1, 2).double() + 0.5
    assert pixels == pytest.approx(want, abs=1e-9)
    assert z == pytest.approx(depth.reshape(-1), abs=1e-9)


def test_the_mask_pixel_by_pixel():
    where = turned_camera(1, width=24, height=18)
    depth = 3.5 + noise_image(18, 24, 0)[..., 0]
    depth[0, 0], depth[0, 1], depth[0, 2] = 0.0, math.inf, math.nan
    boxes = [box([-0.5, 0.0, 0.0], [0.5, 0.8, 0.6], 30), box([0.6, 0.1, 0.2], [0.4, 0.9, 0.5])]
    # Depth 0 must not become a point at the camera, which lies in the rim of this one.
    at_camera = where.centre + torch.tensor([0.2 * 1.15 * 1.05, 0.0, 0.0])
    boxes.append(box(at_camera.tolist(), [0.2, 0.2, 0.2]))
    # Nor one at depth 1, wherever that is for these pixels.
    at_one = back_project(torch.ones(18, 24), where)[0, 1] + torch.tensor([0.1 * 1.15 * 1.05, 0, 0])
    boxes.append(box(at_one.tolist(), [0.1, 0.1, 0.1]))
    got = seam_mask_released(depth, where, boxes)
    pose = where.world_to_camera.numpy()
    want = np.zeros((18, 24), dtype=bool)
    for i in range(18):
        for j in range(24):
            z = float(depth[i, j])
            if not (math.isfinite(z) and z > 0):
                continue
            ray = np.linalg.solve(where.K.numpy(), [j + 0.5, i + 0.5, 1.0])
            point = np.linalg.solve(pose, [*(z * ray), 1.0])[:3]
            for b in boxes:
                local = b.rotation.numpy() @ (point - b.centre.numpy())
                distance = np.abs(local / (1.15 * b.half.numpy())).max()
                want[i, j] |= 1.0 < distance <= 1.1
    assert np.array_equal(got.numpy(), want)
    assert 0.02 < want.mean() < 0.9
    assert not np.array_equal(got, seam_mask_released(depth, where, boxes, margin=0.0))


@given(st.integers(3, 12), st.integers(3, 12), st.integers(0, 999))
def test_the_family_by_direct_formulas(height, width, seed):
    image, truth = noise_image(height, width, seed), noise_image(height, width, seed + 1)
    depth = 1 + noise_image(height, width, seed + 2)[..., 0]
    seam = random_mask(height, width, 0.5, seed)
    got = seam_view_released(image, truth, depth, seam)
    x, y, on = image.double().numpy(), truth.double().numpy(), seam.numpy()
    luminance = 0.299 * x[..., 0] + 0.587 * x[..., 1] + 0.114 * x[..., 2]

    def ratio(field):
        slope = np.hypot(*(sobel(field, axis=axis, mode="nearest") for axis in (0, 1)))
        return slope[on].mean() / slope[~on].mean()

    assert got.values == pytest.approx(
        {
            "seam_psnr_released": -10 * np.log10(((x - y)[on] ** 2).mean()),
            "seam_l1_released": np.abs((x - y)[on]).mean(),
            "seam_gradient_ratio_released": ratio(luminance),
            "seam_depth_gradient_ratio_released": ratio(depth.double().numpy()),
        },
        rel=1e-9,
    )


def test_sobel_of_a_ramp():
    """The kernels' weights sum to 8 across a slope of one a pixel; halved by the repeated border."""
    ramp = np.arange(6.0)[None].repeat(4, axis=0)
    assert sobel_magnitude(ramp).tolist() == [[4, 8, 8, 8, 8, 4]] * 4
    assert sobel_magnitude(ramp.T).tolist() == np.array([[4, 8, 8, 8, 8, 4]] * 4).T.tolist()


def test_no_visible_seam_gives_a_ratio_near_one():
    """Published values of nBGJ lie near 1 because they are such ratios."""
    image = noise_image(60, 80, 0)
    got = seam_view_released(image, image, image[..., 0], random_mask(60, 80, 0.5, 1))
    assert got.values["seam_gradient_ratio_released"] == pytest.approx(1, abs=0.05)
    assert got.values["seam_psnr_released"] == math.inf
    assert got.values["seam_l1_released"] == 0
    step = image * 0 + 0.5
    step[:, 40:] += 0.3
    seam = torch.zeros(60, 80, dtype=torch.bool)
    seam[:, 38:42] = True
    step = (step + 0.01 * image).clamp(0, 1)
    got = seam_view_released(step, step, step[..., 0], seam)
    assert got.values["seam_gradient_ratio_released"] > 5


@given(st.integers(0, 99))
def test_truth_outside_the_seam_cannot_matter(seed):
    image, truth, seam = noise_image(9, 9, seed), noise_image(9, 9, seed + 1), None
    seam = random_mask(9, 9, 0.5, seed)
    before = seam_view_released(image, truth, image[..., 0], seam)
    truth[~seam] = math.nan
    assert seam_view_released(image, truth, image[..., 0], seam) == before


@given(st.integers(0, 99))
def test_masked_pixels_are_neither_on_the_seam_nor_off_it(seed):
    image, truth = noise_image(12, 15, seed), noise_image(12, 15, seed + 1)
    seam, mask = random_mask(12, 15, 0.5, seed), random_mask(12, 15, 0.7, seed + 2)
    got = seam_view_released(image, truth, image[..., 0], seam, mask).values
    on, off = (seam & mask).numpy(), (mask & ~seam).numpy()
    slope = sobel_magnitude(image[..., 0].double().numpy())
    if on.any() and off.any():
        want = slope[on].mean() / slope[off].mean()
        assert got["seam_depth_gradient_ratio_released"] == pytest.approx(want, rel=1e-12)
    alone = seam_view_released(image, truth, image[..., 0], seam & mask).values
    assert got["seam_psnr_released"] == pytest.approx(alone["seam_psnr_released"], nan_ok=True)


def test_empty_full_and_flat_are_undefined_with_a_reason():
    image = noise_image(5, 6, 0)
    empty = torch.zeros(5, 6, dtype=torch.bool)
    got = seam_view_released(image, image, image[..., 0], empty)
    assert all(math.isnan(value) for value in got.values.values())
    assert set(got.undefined) == set(NAMES)
    full = seam_view_released(image, 1 - image, image[..., 0], ~empty)
    assert set(full.undefined) == set(NAMES[2:])
    half = empty.clone()
    half[:, :3] = True
    flat = seam_view_released(image, 1 - image, torch.ones(5, 6), half)
    assert set(flat.undefined) == {NAMES[3]}


def test_a_scene_is_the_mean_of_the_views_in_which_it_is_defined():
    def view(value):
        missing = {} if math.isfinite(value) else dict.fromkeys(NAMES, "empty")
        return SeamScores(values={name: value for name in NAMES}, undefined=missing)

    got = seam_scores_released([view(20.0), view(math.nan), view(30.0)])
    assert got.values == dict.fromkeys(NAMES, 25.0)
    assert not got.undefined
    nothing = seam_scores_released([view(math.nan)])
    assert set(nothing.undefined) == set(NAMES)
    assert all(math.isnan(value) for value in nothing.values.values())


def test_a_depth_that_is_not_finite_is_refused():
    image = noise_image(5, 6, 0)
    with pytest.raises(DataError, match="not finite"):
        seam_view_released(image, image, image[..., 0] * math.nan, image[..., 0] > 0.5)
