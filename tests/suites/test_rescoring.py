"""`bench score` of a case's own folder gives its record again, to the last digit."""

import contextlib
import io
import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from helpers.images import noise_image, random_mask
from helpers.tiny_scene import camera, tiny_scene
from splatproof.cli import main
from splatproof.cli.output import finite
from splatproof.datasets.photos import read_photo
from splatproof.methods.contracts.reconstruction import Stored
from splatproof.metrics.parts import is_part_key
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.scoring import scene_metrics
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.result import ImageScore
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.held_out import score_views

HEIGHT, WIDTH = 18, 24
RULES = load_protocol("default")


@dataclass
class Painted:
    """Renders given pixels, the same from everywhere."""

    pixels: Tensor
    primitives: int = 1

    kind: str = "painted"

    def render(self, view: View, background: Tensor | None = None) -> RenderOutput:
        flat = torch.zeros(self.pixels.shape[:2])
        return RenderOutput(colour=self.pixels, alpha=flat, depth=flat, radii=torch.zeros(1))

    def store(self, folder: Path) -> Stored:
        raise AssertionError("nothing is saved here")


def town(truths: list[Tensor], mask: Tensor | None) -> Scene:
    """One test view a truth; names whose order as files is another than as views."""
    views = tuple(
        View(
            name=f"{'cam' * (i % 2)}{i % 3}/{i}.jpg",
            camera=camera(0, width=WIDTH, height=HEIGHT),
            load=truth.clone,
            load_mask=None if mask is None else mask.clone,
        )
        for i, truth in enumerate(truths)
    )
    return replace(tiny_scene(), views=views, train=(0,), test=tuple(range(len(views))))


def scored_again(folder: Path, protocol: Protocol) -> list[dict[str, object]]:
    """What `bench score --json` says of the pictures in a case folder, the mean last."""
    rules = {
        "rounding": protocol.rounding,
        "region": protocol.region,
        "colour_fit": list(protocol.colour_fit),
        "metrics": list(protocol.metrics),
    }
    path = folder / "rules.toml"
    lines = [f"{name} = {json.dumps(value)}\n" for name, value in rules.items()]
    path.write_text('source = "test"\n' + "".join(lines))
    masks = ["--masks", str(folder / "masks")] if (folder / "masks").exists() else []
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        options = ["--protocol", str(path), "--json", "--quiet", *masks]
        assert main(["score", str(folder / "renders"), str(folder / "truth"), *options]) == 0
    return [json.loads(line) for line in said.getvalue().splitlines()]


def assert_same(images: tuple[ImageScore, ...], again: list[dict[str, object]]) -> None:
    *lines, mean = again
    found = {line["truth_sha256"]: line for line in lines}
    for image in images:
        line = found[image.truth_sha256]
        assert line["valid_share"] == image.valid_share
        assert image.metrics
        for name, value in image.metrics.items():
            if not is_part_key(name):  # parts are known of scenes, not of pictures
                assert line[name] == finite(value), name
    for name, value in scene_metrics(images).items():
        if not is_part_key(name):
            assert mean[name] == finite(value), name


@given(
    seed=st.integers(0, 2**16),
    rounding=st.sampled_from(["round", "truncate", "float"]),
    region=st.sampled_from(["full", "right_half"]),
    fits=st.sampled_from([(), ("cc_affine",)]),
    distance=st.sampled_from([0.0, 1e-5, 1e-3, 0.3]),
    masked=st.booleans(),
    bits=st.sampled_from([8, 24]),
)
@settings(deadline=None, max_examples=25)
def test_a_case_folder_scores_as_its_record_says(
    seed, rounding, region, fits, distance, masked, bits
):
    protocol = replace(RULES, rounding=rounding, region=region, colour_fit=fits)
    truths = [noise_image(HEIGHT, WIDTH, seed + i) for i in range(3)]
    if bits == 8:
        truths = [torch.floor(truth * 255) / 255 for truth in truths]
    # some pixels lie outside [0, 1], as renders do
    shown = truths[0] + distance * (4 * noise_image(HEIGHT, WIDTH, seed + 9) - 2)
    mask = random_mask(HEIGHT, WIDTH, 0.9, seed) if masked else None
    with tempfile.TemporaryDirectory() as name:
        images = score_views(town(truths, mask), Painted(shown), protocol, Path(name))
        assert_same(images, scored_again(Path(name), protocol))


def test_the_comparison_sees_truth_of_8_bit(tmp_path):
    protocol = replace(RULES, rounding="float")
    truth = noise_image(HEIGHT, WIDTH, 0)
    images = score_views(town([truth], None), Painted(truth * 0.999), protocol, tmp_path)
    assert_same(images, scored_again(tmp_path, protocol))
    (path,) = (tmp_path / "truth").iterdir()
    coarse = cv2.imread(str(path))  # 8 bit
    assert coarse is not None
    cv2.imwrite(str(path), coarse)
    with pytest.raises(KeyError):
        assert_same(images, scored_again(tmp_path, protocol))


def test_a_truth_that_bytes_hold_is_kept_and_hashed_as_it_is(tmp_path):
    truth = torch.floor(noise_image(HEIGHT, WIDTH, 0) * 255) / 255
    score_views(town([truth], None), Painted(truth), RULES, tmp_path)
    (path,) = (tmp_path / "truth").iterdir()
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    assert stored.dtype == np.uint8
    assert torch.equal(read_photo(path), truth)


def test_what_is_scored_is_within_half_a_16_bit_step_of_the_truth(tmp_path):
    truth = noise_image(HEIGHT, WIDTH, 0)
    score_views(town([truth], None), Painted(truth), RULES, tmp_path)
    (path,) = (tmp_path / "truth").iterdir()
    assert (read_photo(path) - truth).abs().max() <= 0.5 / 65535 + 1e-7
    assert (read_photo(path) - truth).abs().max() > 0.4 / 65535
