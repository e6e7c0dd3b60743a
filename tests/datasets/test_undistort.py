"""Truth images against exact geometry: every COLMAP model, both rules, through the down-scale."""

import dataclasses

import numpy as np
import pycolmap
import pytest
import torch
from PIL import Image

from helpers.colmap_scenes import (
    MODELS,
    Flight,
    photo,
    pixel_centres,
    pose,
    reconstruction,
    trace,
    view_name,
    write_scene,
)
from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.photos import read_photo
from splatproof.datasets.resize import resample
from splatproof.datasets.truth_image import Truth, shrink_mask
from splatproof.datasets.undistort import (
    is_pinhole,
    photo_positions,
    plan_undistortion,
    undistort_image,
)
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol

DISTORTED = [name for name in MODELS if "PINHOLE" not in name]
every_model = pytest.mark.parametrize("model", MODELS)
every_distortion = pytest.mark.parametrize("model", DISTORTED)


def flight(model: str, **changes) -> Flight:
    return Flight(model=model, params=MODELS[model], views=2, **changes)


def protocol(**rules) -> Protocol:
    return Protocol(name="test", source="test", hold=0, **rules)


def observed(made: Flight, i: int) -> tuple[np.ndarray, np.ndarray]:
    """(world positions, photo pixels) of view i's observations."""
    model = reconstruction(made)
    image = model.find_image_with_name(view_name(i))
    assert image is not None
    seen = [point for point in image.points2D if point.has_point3D()]
    world = np.stack([model.point3D(point.point3D_id).xyz for point in seen])
    return world, np.stack([point.xy for point in seen])


@every_model
@pytest.mark.parametrize("undistort", ["crop", "keep"])
def test_points_land_where_their_observations_go(tmp_path, model, undistort):
    """The photo pixel of every observation, found in the position map, is the point's pixel."""
    made = flight(model)
    scene = open_scene(write_scene(tmp_path / "s", made), protocol(width=37, undistort=undistort))
    for i, view in enumerate(scene.views):
        world, pixels = observed(made, i)
        projected, depth = project_points(view.camera, torch.from_numpy(world))
        assert (depth > 0).all()
        plane = np.asarray(made.camera.cam_from_img(pixels))
        mapped = plane @ view.camera.K.numpy()[:2, :2].T + view.camera.K.numpy()[:2, 2]
        # cam_from_img iterates to about 1e-10 of the focal length
        assert np.abs(projected.numpy() - mapped).max() < 1e-6


def spots(made: Flight, i: int) -> np.ndarray:
    """Photo of view i with a soft spot at each of a few plane positions: pixels that can be found."""
    seen = trace(made, i, made.camera, pixel_centres(*made.size))
    away = ((seen[:, :, None] - SPOTS) ** 2).sum(-1)
    return np.exp(-away / (2 * 0.12**2)).sum(-1)[..., None].repeat(3, -1)


SPOTS = np.array([[x, y] for x in (-0.9, 0.2, 1.3) for y in (-0.8, 0.4, 1.2)])


@pytest.mark.parametrize("order", ["full", "scaled"])
@pytest.mark.parametrize(
    ("model", "filter"),
    [(model, "area") for model in MODELS] + [("OPENCV", "lanczos"), ("FOV", "bicubic")],
)
def test_content_lands_where_the_camera_says(tmp_path, model, filter, order):
    """Centroids of spots in the truth image are where its pinhole projects the spots: < 0.1 px."""
    made = scaled_up(model)
    scene_folder = write_scene(tmp_path / "s", made)
    pixels = np.round(255 * spots(made, 0).clip(0, 1)).astype(np.uint8)
    Image.fromarray(pixels).save(scene_folder / "photos" / view_name(0))
    scene = open_scene(scene_folder, protocol(width=110, filter=filter, undistort_at=order))
    view = scene.views[0]
    image = view.load()[..., 0]
    world = torch.from_numpy(np.concatenate([SPOTS, np.zeros((len(SPOTS), 1))], axis=1))
    where, _ = project_points(view.camera, world)
    found = 0
    for x, y in where.tolist():
        if not (8 < x < view.camera.width - 8 and 8 < y < view.camera.height - 8):
            continue
        left, top = int(x) - 7, int(y) - 7
        window = image[top : top + 15, left : left + 15].double()
        total = window.sum()
        centre_x = (window.sum(0) * (torch.arange(15) + left + 0.5)).sum() / total
        centre_y = (window.sum(1) * (torch.arange(15) + top + 0.5)).sum() / total
        assert abs(centre_x - x) < 0.1
        assert abs(centre_y - y) < 0.1
        found += 1
    assert found >= 2


def scaled_up(model: str) -> Flight:
    """The same camera at three times the resolution."""
    camera = flight(model).camera
    camera.rescale(3.0)
    size = (camera.width, camera.height)
    return Flight(model=model, params=camera.params.tolist(), size=size, views=2)


@every_model
@pytest.mark.parametrize("undistort", ["crop", "keep"])
def test_colours_are_those_that_the_pinhole_sees(tmp_path, model, undistort):
    """A painted plane traced through the pinhole itself, 4 x 4 rays a pixel, equals the truth."""
    made = scaled_up(model)
    scene = open_scene(write_scene(tmp_path / "s", made), protocol(factor=3.0, undistort=undistort))
    view = scene.views[0]
    camera = view.camera
    pinhole = pycolmap.Camera(
        camera_id=1,
        model="PINHOLE",
        width=camera.width,
        height=camera.height,
        params=[camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]],
    )
    fine = pixel_centres(camera.width * 4, camera.height * 4) / 4
    seen = made.paint(trace(made, 0, pinhole, fine))
    expected = seen.reshape(camera.height, 4, camera.width, 4, 3).mean((1, 3))
    error = np.abs(view.load().numpy() - expected)
    if view.load_mask is not None:
        error = error[view.load_mask().numpy()]
    # 8-bit photos (1/510) and bilinear curvature of the pattern between photo pixels
    assert error.max() < 0.02
    assert error.mean() < 0.002


@every_distortion
def test_crop_has_no_invalid_pixel(model):
    plan = plan_undistortion(flight(model).camera, "crop")
    assert not photo_positions(plan).isnan().any()


@every_distortion
def test_crop_equals_colmaps_own_undistortion(model):
    """Same camera and, up to COLMAP's rounding to 8 bit, the same pixels."""
    made = flight(model)
    options = pycolmap.UndistortCameraOptions()
    bitmap, camera = pycolmap.undistort_image(
        options, pycolmap.Bitmap.from_array(photo(made, 0)), made.camera
    )
    plan = plan_undistortion(made.camera, "crop")
    left = round(camera.principal_point_x - float(plan.K[0, 2]))
    top = round(camera.principal_point_y - float(plan.K[1, 2]))
    assert 0 <= left <= 2
    assert 0 <= top <= 2
    assert camera.focal_length_x == float(plan.K[0, 0])
    image = torch.from_numpy(photo(made, 0)).float() / 255
    mine = undistort_image(image, photo_positions(plan)).numpy()
    theirs = bitmap.to_array()[top : top + plan.height, left : left + plan.width] / 255
    inner = slice(2, -2)  # COLMAP leaves pixels within half a pixel of the border black
    assert np.abs(mine - theirs)[inner, inner].max() < 0.5 / 255 + 1e-5


@every_distortion
def test_keep_has_every_photo_pixel_and_masks_the_rest(model):
    camera = flight(model).camera
    plan = plan_undistortion(camera, "keep")
    valid = ~photo_positions(plan).isnan().any(-1)
    centres = pixel_centres(camera.width, camera.height).reshape(-1, 2)
    plane = np.asarray(camera.cam_from_img(centres))
    pixels = plane @ plan.K.numpy()[:2, :2].T + plan.K.numpy()[:2, 2]
    assert (pixels >= 0).all()
    assert (pixels <= [plan.width, plan.height]).all()
    column, row = np.floor(pixels).astype(int).T
    inner = ((centres > 3) & (centres < [camera.width - 3, camera.height - 3])).all(1)
    assert valid.numpy()[row, column][inner].all()
    assert 0 < (~valid).sum() < valid.numel() / 2


@pytest.mark.parametrize("order", ["full", "scaled"])
@pytest.mark.parametrize("filter", ["area", "lanczos", "bicubic", "bilinear"])
def test_no_invalid_pixel_bleeds_into_a_valid_one(tmp_path, filter, order):
    """A white photo stays white under the mask; outside it is black."""
    made = dataclasses.replace(scaled_up("OPENCV"), paint=lambda xy: np.ones((*xy.shape[:-1], 3)))
    folder = write_scene(tmp_path / "s", made)
    rules = protocol(width=80, undistort="keep", filter=filter, undistort_at=order)
    view = open_scene(folder, rules).views[0]
    assert view.load_mask is not None
    image, mask = view.load(), view.load_mask()
    assert 0 < (~mask).sum() < mask.numel() / 3
    assert (image[mask] - 1).abs().max() < 1e-6
    assert (image[~mask] == 0).all()


@every_model
@pytest.mark.parametrize("undistort", ["crop", "keep"])
@pytest.mark.parametrize("form", ["PNG", "JPEG"])
def test_a_photo_that_is_read_small_shows_what_the_smaller_camera_sees(
    tmp_path, model, undistort, form
):
    """Spots of a photo whose full pixels nobody makes lie where they lie in the shrunk one, to 0.02 pixels."""
    made = scaled_up(model)
    folder = write_scene(tmp_path / "s", made)
    pixels = np.round(255 * spots(made, 0).clip(0, 1)).astype(np.uint8)
    Image.fromarray(pixels).save(folder / "photos" / view_name(0), format=form, quality=98)
    view = open_scene(folder, protocol(undistort=undistort)).views[0]
    assert isinstance(view.load, Truth)
    half = read_photo(view.load.path, least=(made.size[0] // 2, made.size[1] // 2)).shape
    assert half == (*(-(-side // (2 if form == "JPEG" else 1)) for side in made.size[::-1]), 3)
    size = (view.camera.width // 3, view.camera.height // 3)
    whole = resample(view.load(), size, "area")[..., 0].double()
    small = view.load.at(size)[..., 0].double()
    assert small.shape == whole.shape
    inside = torch.ones_like(whole, dtype=torch.bool) if view.load_mask is None else shrink_mask(
        view.load_mask(), size, "area"
    )  # fmt: skip
    whole, small = whole * inside, small * inside
    slopes = torch.stack([g[inside] for g in torch.gradient(whole)], dim=1)
    shift = torch.linalg.lstsq(slopes, (small - whole)[inside][:, None]).solution
    assert float(shift.abs().max()) < 0.02
    assert float((small - whole).abs().mean()) < 0.01


@pytest.mark.parametrize("part", [1, 2, 4, 8])
def test_a_jpeg_that_is_decoded_small_is_the_whole_photo_and_no_more(tmp_path, part):
    """137 x 85: its last blocks of 8 x 8 reach up to 7 pixels beyond the photo, and so did what was read."""
    width, height = 137, 85
    across, down = (np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height
    ramps = np.stack([*np.meshgrid(across, down), np.full((height, width), 0.5)], axis=-1)
    path = tmp_path / "ramps.jpg"
    Image.fromarray(np.round(255 * ramps).astype(np.uint8)).save(path, quality=98, subsampling=0)
    found = read_photo(path, least=(width // part, height // part))
    assert found.shape[:2] == (-(-height // part), -(-width // part))
    for axis in (0, 1):
        count = found.shape[axis]
        share = (torch.arange(count) + 0.5) / count
        wanted = share[:, None] if axis == 0 else share
        # a whole block at an eighth would be off by 0.05; 8 bits and JPEG are off by 0.010 here
        assert (found[..., 1 - axis] - wanted).abs().max() < 0.012


@every_distortion
@pytest.mark.parametrize("undistort", ["crop", "keep"])
def test_the_order_changes_no_geometry_and_is_nothing_without_a_down_scale(
    tmp_path, model, undistort
):
    folder = write_scene(tmp_path / "s", flight(model))

    def view(**rules):
        return open_scene(folder, protocol(undistort=undistort, **rules)).views[0]

    before, after = (view(width=37, undistort_at=order) for order in ("full", "scaled"))
    assert torch.equal(before.camera.K, after.camera.K)
    assert before.camera.width == after.camera.width == 37
    assert before.camera.height == after.camera.height
    same = [view(undistort_at=order).load() for order in ("full", "scaled")]
    assert torch.equal(*same)


def test_undistorting_a_small_photo_blurs_it(tmp_path):
    """What the order is worth: noise of one photo pixel loses contrast in the second sampling."""
    made = scaled_up("OPENCV")
    folder = write_scene(tmp_path / "s", made)
    noise = np.random.default_rng(0).integers(0, 256, (made.size[1], made.size[0], 3))
    Image.fromarray(noise.astype(np.uint8)).save(folder / "photos" / view_name(0))
    images = [
        open_scene(folder, protocol(factor=3.0, undistort_at=order)).views[0].load()
        for order in ("full", "scaled")
    ]
    # bilinear at random places keeps (2 / 3)^2 of the variance of white noise
    assert float(images[1].var() / images[0].var()) < 0.7


def test_a_pinhole_photo_is_passed_through_bit_for_bit(tmp_path):
    made = flight("PINHOLE")
    view = open_scene(write_scene(tmp_path / "s", made), protocol()).views[1]
    assert torch.equal(view.load(), torch.from_numpy(photo(made, 1)).float() / 255)
    assert view.load_mask is None


def test_a_fisheye_without_coefficients_is_no_pinhole():
    assert not is_pinhole(flight("SIMPLE_FISHEYE").camera)
    assert is_pinhole(flight("PINHOLE").camera)


@pytest.mark.parametrize(
    ("model", "params", "rule", "fault"),
    [
        ("EQUIRECTANGULAR", [96, 72], "crop", "EQUIRECTANGULAR cannot become one pinhole"),
        ("SIMPLE_FISHEYE", [30, 48, 36], "keep", "exceed 4 times the photo"),
        ("RADIAL", [40, 48, 36, -0.9, 0.1], "crop", "folds back|no rectangle"),
    ],
)
def test_impossible_cameras_are_refused(model, params, rule, fault):
    camera = pycolmap.Camera(model=model, width=96, height=72, params=params)
    with pytest.raises(DataError, match=fault):
        plan_undistortion(camera, rule)


def test_the_geometry_checks_see_a_shift_of_a_tenth_of_a_pixel(tmp_path):
    made = flight("OPENCV")
    view = open_scene(write_scene(tmp_path / "s", made), protocol(width=37)).views[0]
    world, pixels = observed(made, 0)
    assert len(pixels) > 10
    K = view.camera.K.clone()
    K[0, 2] += 0.1
    moved = dataclasses.replace(view.camera, K=K)
    projected, _ = project_points(moved, torch.from_numpy(world))
    plane = np.asarray(made.camera.cam_from_img(pixels))
    mapped = plane @ view.camera.K.numpy()[:2, :2].T + view.camera.K.numpy()[:2, 2]
    assert np.abs(projected.numpy() - mapped).max() == pytest.approx(0.1)
    assert pose(made, 0).rotation.matrix() == pytest.approx(view.camera.rotation.numpy())
