"""Pictures of several rows in lines: each has its name above it."""

import cv2
import numpy as np
from picture_lines import draw_lines
from strips import BAR


def test_photos_and_lines_have_names_above_them(tmp_path):
    lines = ["a/p/seed0/renders", "a/p/seed0/errors"]
    for number, folder in enumerate(["a/p/seed0/truth", *lines]):
        (tmp_path / folder).mkdir(parents=True)
        for view in ("1.png", "2.png"):
            image = np.full((40, 300, 3), 50 * number, np.uint8)
            cv2.imwrite(str(tmp_path / folder / view), image)
    path = tmp_path / "lines.png"
    draw_lines(path, tmp_path, [*lines, "b/p/seed0/renders"])
    assert not path.exists()
    draw_lines(path, tmp_path, lines)
    found = cv2.imread(str(path))
    assert found is not None
    assert found.shape == (3 * (BAR + 40), 600, 3)
    for number in range(3):
        top = number * (BAR + 40)
        name, image = found[top : top + BAR], found[top + BAR : top + BAR + 40]
        assert name.min() == 0
        assert (image == 50 * number).all()
