import numpy as np
import pytest

from helpers.adapter_checks import hard_links, opens_in_bounds, protocol, refused, without
from helpers.posed_scenes import POINTS, SIZE, blob, opengl_rays, opengl_to_world, worst_error
from splatproof.datasets.catalogue.opening import open_scene

FOCAL = 80.0


def llff(folder, *, views=4, order=(0, 1, 2), paint=True):
    """Rows as LLFF writes them: columns down, right, back (or in a wrong order), then the centre."""
    rows, points = [], {}
    for i in range(views):
        pose, point = opengl_to_world(i), POINTS[i % 3]
        if paint:
            pixel = (opengl_rays(pose, point[None]) * FOCAL + np.array(SIZE) / 2)[0]
            blob(folder / f"images/img_{i:04d}.JPG", pixel)
            half = pixel / 2
            blob(folder / f"images_2/img_{i:04d}.png", half, size=(SIZE[0] // 2, SIZE[1] // 2))
        points[f"img_{i:04d}.JPG"] = point
        columns = [-pose[:3, 1], pose[:3, 0], pose[:3, 2]]
        matrix = np.stack([*(columns[k] for k in order), pose[:3, 3]], axis=1)
        size = np.array([SIZE[1], SIZE[0], FOCAL])
        rows.append(np.concatenate([np.c_[matrix, size].ravel(), [0.5 + i, 9.0]]))
    np.save(folder / "poses_bounds.npy", np.stack(rows))
    return points


def test_points_are_seen_where_they_were_painted(tmp_path):
    points = llff(tmp_path)
    scene = open_scene(tmp_path, protocol(hold=8))
    assert worst_error(scene, points) < 0.1
    assert scene.test == (0,)
    assert scene.facts["depth_bounds"] == "0.5 to 9"
    small = open_scene(tmp_path, protocol(images="images_2"))
    assert (small.views[0].camera.width, small.views[0].camera.height) == (48, 36)
    assert worst_error(small, {n.replace("JPG", "png"): p for n, p in points.items()}) < 0.1


def test_axes_in_another_order_are_noticed(tmp_path):
    points = llff(tmp_path, order=(1, 2, 0))
    assert worst_error(open_scene(tmp_path, protocol()), points) > 0.1


def test_faults_are_named(tmp_path):
    llff(tmp_path)
    path = tmp_path / "poses_bounds.npy"
    rows = np.load(path)
    path.write_bytes(b"rubbish")
    refused(tmp_path, r"poses_bounds\.npy: not an array")
    np.save(path, rows[:, :15])
    refused(tmp_path, r"shape \(4, 15\), expected rows of 17")
    np.save(path, rows[:3])
    refused(tmp_path, "has 3 rows, but .* has 4 photos")
    np.save(path, np.where(np.arange(17) == 14, -1.0, rows))
    refused(tmp_path, r"row 0 \(img_0000.JPG\): focal length is -1.0")
    np.save(path, rows)
    without(tmp_path / "images/img_0002.JPG", tmp_path, "has 4 rows, but .* has 3 photos")
    refused(tmp_path, "looked for the folder images_9", images="images_9")


@pytest.mark.slow
def test_five_thousand_views(tmp_path):
    llff(tmp_path, views=5000, paint=False)
    blob(tmp_path / "one.png", np.array([5.0, 5.0]))
    hard_links(tmp_path / "one.png", [tmp_path / f"images/{i:05d}.png" for i in range(5000)])
    opens_in_bounds(tmp_path, 5000)


def test_a_copy_of_the_wrong_size_is_refused(tmp_path):
    llff(tmp_path)
    (tmp_path / "images_2").rename(tmp_path / "images_3")
    refused(tmp_path, "photo is 48 x 36, its camera says 96 x 72", images="images_3")
