"""RoMa as a matcher: where matches lie, to a fraction of a pixel, by networks that say known ones; its weights; its real tiny class."""

import importlib
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor
from torch.testing import assert_close

from helpers import tiny_roma
from splatproof.base.errors import DataError, MissingError
from splatproof.methods.priors import roma
from splatproof.methods.priors.roma import RomaMatcher, load_matcher
from splatproof.reference.supervision.dense_matching import DenseMatcher

SHIFT = torch.tensor([[1, 0, 7.25], [0, 1, -3.5], [0, 0, 1]]).double()
TURNED = torch.tensor([[0.9, -0.2, 9.0], [0.25, 1.1, -4.0], [4e-4, -3e-4, 1]]).double()


def middles(height: int, width: int) -> Float[Tensor, "h w 2"]:
    """Middles of pixels, x and y."""
    row, column = torch.meshgrid(
        torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij"
    )
    return torch.stack([column, row], dim=-1).double()


def through(plane: Float[Tensor, "3 3"], at: Float[Tensor, "h w 2"]) -> Float[Tensor, "h w 2"]:
    far = torch.cat([at, torch.ones_like(at[..., :1])], dim=-1) @ plane.T
    return far[..., :2] / far[..., 2:]


class Says:
    """A network that says a homography of the photos' pixels, on a grid of its own, as a batch or not."""

    def __init__(self, plane, size_a, size_b, grid=None, *, batched: bool = True) -> None:
        self.plane, self.grid, self.batched = plane, grid, batched
        self.a, self.b = (torch.tensor([w, h]).double() for h, w in (size_a, size_b))

    def match(self, im_a: Image.Image, im_b: Image.Image):
        rows, columns = self.grid or (im_a.size[1], im_a.size[0])
        here = 2 * middles(rows, columns) / torch.tensor([columns, rows]) - 1
        there = 2 * through(self.plane, (here + 1) / 2 * self.a) / self.b - 1
        warp = torch.cat([here, there], dim=-1).float()
        sure = torch.full((rows, columns), 0.75)
        return (warp[None], sure[None]) if self.batched else (warp, sure)


@pytest.mark.parametrize("batched", [True, False])
@pytest.mark.parametrize("grid", [(96, 96), (40, 64), None])
@pytest.mark.parametrize(("size_a", "size_b"), [((48, 64), (48, 64)), ((61, 47), (90, 133))])
@pytest.mark.parametrize(("plane", "off"), [(SHIFT, 1e-3), (TURNED, 0.1)])
def test_pixels_land_where_the_network_says(plane, off, size_a, size_b, grid, batched):
    """A shift to rounding; a homography within what straight lines between nodes lose, far below half a pixel."""
    network = Says(plane, size_a, size_b, grid, batched=batched)
    matcher: DenseMatcher = RomaMatcher(network)
    warp, certainty = matcher(torch.rand(*size_a, 3), torch.rand(*size_b, 3))
    at = middles(*size_a)
    want = through(plane, at)
    assert warp.shape == (*size_a, 2)
    assert float((warp.double() - (want - at)).abs().max()) < off
    inside = ((want > 0.2) & (want < torch.tensor(size_b).flip(0) - 0.2)).all(dim=-1)
    outside = ((want < -0.2) | (want > torch.tensor(size_b).flip(0) + 0.2)).any(dim=-1)
    assert 0.1 < float(inside.double().mean()) < 1
    assert_close(certainty[inside], torch.full((int(inside.sum()),), 0.75))
    assert not certainty[outside].any()


def test_between_the_nodes_of_a_coarse_grid_matches_lie_on_straight_lines():
    """Exact for a linear map, but for the half of a cell that the outermost nodes lie inside the edge."""
    plane = torch.tensor([[1.8, 0.3, -5], [-0.4, 0.5, 20], [0, 0, 1]]).double()
    warp, _ = RomaMatcher(Says(plane, (60, 45), (80, 90), (12, 9)))(
        torch.rand(60, 45, 3), torch.rand(80, 90, 3)
    )
    want = through(plane, middles(60, 45)) - middles(60, 45)
    inner = slice(2, -2)  # cells are 5 pixels high and wide
    assert_close(warp[inner, inner].double(), want[inner, inner], atol=1e-3, rtol=0)
    assert float((warp.double() - want).norm(dim=-1).max()) < 4


def told(image: Image.Image) -> Float[Tensor, "h w 3"]:
    return torch.from_numpy(np.array(image)).double() / 255


class Reads:
    """A network that reads places off colours: red and green say where both photos see the same ground."""

    def __init__(self) -> None:
        self.sizes: list[tuple[int, int]] = []

    def match(self, im_a: Image.Image, im_b: Image.Image):
        self.sizes += [im_a.size, im_b.size]
        a, b = told(im_a), told(im_b)
        here, there = (
            2 * middles(*p.shape[:2]) / torch.tensor(p.shape[:2]).flip(0) - 1 for p in (a, b)
        )
        row = torch.ones_like(b[..., :1])
        ground = torch.cat([b[..., :2], row], dim=-1).reshape(-1, 3)
        fit = torch.linalg.lstsq(ground, there.reshape(-1, 2)).solution
        landed = torch.cat([a[..., :2], torch.ones_like(a[..., :1])], dim=-1) @ fit
        return torch.cat([here, landed], dim=-1).float(), torch.ones(a.shape[:2])


def ground(
    height: int, width: int, left: float, top: float, scale: float
) -> Float[Tensor, "h w 3"]:
    """A photo of a ground whose red grows to the right and green downwards; a pixel is `scale` of it wide."""
    at = scale * middles(height, width) + torch.tensor([left, top])
    return torch.cat([at / 200, torch.zeros(height, width, 1)], dim=-1).float()


@pytest.mark.parametrize("longest", [None, 64])
def test_what_the_network_sees_lies_where_the_photos_have_it(longest):
    """Through the picture that it is given, made smaller or not: off by less than a quarter of a pixel on average.

    A level of 255 is 0.8 of the ground's units, so that a pixel is read to about 0.2 of them, of either sign.
    """
    a, b = ground(50, 70, 30, 40, 1.0), ground(90, 120, 20, 50, 0.8)
    network = Reads()
    warp, certainty = RomaMatcher(network, longest=longest)(a, b)
    at = middles(50, 70)
    want = (at + torch.tensor([10.0, -10.0])) / 0.8 - at
    kept = certainty > 0
    assert 0.5 < float(kept.double().mean()) < 1
    error = warp[kept].double() - want[kept]
    assert float(error.mean(dim=0).abs().max()) < 0.1
    assert float(error.norm(dim=-1).mean()) < 0.5
    assert network.sizes == ([(70, 50), (120, 90)] if longest is None else [(64, 46), (64, 48)])


def test_a_photo_keeps_its_levels_and_is_never_too_small():
    image = torch.arange(3 * 40 * 50).reshape(40, 50, 3) % 256 / 255
    assert np.array_equal(np.array(roma.picture(image, None)), (image * 255).round().numpy())
    assert roma.picture(torch.rand(8, 400, 3), 100).size == (100, 32)
    assert roma.picture(torch.rand(8, 8, 3), None).size == (32, 32)


def test_threads_share_one_network_in_turns():
    class Slow(Says):
        inside = most = 0

        def match(self, im_a, im_b):
            self.inside += 1
            self.most = max(self.most, self.inside)
            time.sleep(0.01)
            self.inside -= 1
            return super().match(im_a, im_b)

    network = Slow(SHIFT, (48, 64), (48, 64))
    matcher, photo = RomaMatcher(network), torch.rand(48, 64, 3)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: matcher(photo, photo)[0], range(8)))
    assert network.most == 1
    assert all(torch.equal(one, found[0]) for one in found)


def saved(path: Path, held: object = None) -> Path:
    torch.save({"one": torch.ones(2)} if held is None else held, path)
    return path


@pytest.fixture
def _no_network(monkeypatch):
    def fetch(*given: object, **more: object) -> None:
        raise AssertionError(f"{given} was to be fetched")

    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", fetch)
    monkeypatch.setattr(torch.hub, "load", fetch)
    monkeypatch.setattr("socket.socket.connect", fetch)


def test_the_tiny_network_is_given_its_weights_and_what_it_sees_with(tmp_path, monkeypatch):
    tiny_roma.stand_in(monkeypatch)
    saved(tmp_path / tiny_roma.NAME)
    matcher = load_matcher(tmp_path)
    network = matcher._network
    assert network.one.tolist() == [1, 1]
    assert not network.training
    sees = network.given["xfeat"]
    assert matcher._longest == roma.LONGEST
    assert sum(values.numel() for values in sees.parameters()) == 628_932 + 4_160 + 48
    for head in ("heatmap_head", "keypoint_head", "fine_matcher"):
        delattr(sees, head)


@pytest.mark.parametrize("name", ["roma_outdoor.pth", "roma_indoor.pth"])
def test_the_whole_network_is_given_both_files(tmp_path, monkeypatch, name):
    tiny_roma.stand_in(monkeypatch)
    saved(tmp_path / name)
    saved(tmp_path / roma.BACKBONE, {"two": torch.zeros(1)})
    matcher = load_matcher(tmp_path)
    given = matcher._network.given
    assert list(given["dinov2_weights"]) == ["two"]
    assert (given["symmetric"], given["use_custom_corr"]) == (False, False)
    assert (str(given["device"]), given["amp_dtype"]) == ("cpu", torch.float32)
    assert matcher._longest is None


def test_what_is_missing_or_damaged_is_told_in_one_line_with_what_to_do(tmp_path, monkeypatch):
    tiny_roma.stand_in(monkeypatch)
    flow = ".*--dense.matcher flow"

    def refused(fault: type[Exception], match: str) -> None:
        with pytest.raises(fault, match=match) as error:
            load_matcher(tmp_path / "w")
        assert "\n" not in str(error.value)

    refused(MissingError, "w: no such folder of weights" + flow)
    (tmp_path / "w").mkdir()
    refused(DataError, "w: holds no weights of RoMa; expected tiny_roma_v1_outdoor.pth, or roma_")
    path = saved(tmp_path / "w" / "roma_outdoor.pth")
    refused(MissingError, roma.BACKBONE + ": no such file" + flow)
    saved(tmp_path / "w" / tiny_roma.NAME)
    refused(DataError, "holds roma_outdoor.pth, tiny_roma_v1_outdoor.pth; expected")
    path.unlink()
    path = tmp_path / "w" / tiny_roma.NAME
    for content in (b"", b"x" * 100, path.read_bytes()[:300]):
        path.write_bytes(content)
        refused(DataError, tiny_roma.NAME + ": not the weights that are expected" + flow)
    for held in ({"three": torch.zeros(1)}, [1]):
        saved(path, held)
        refused(DataError, tiny_roma.NAME + ": not the weights that are expected" + flow)


def test_weights_run_no_code(tmp_path, monkeypatch):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "run",))

    tiny_roma.stand_in(monkeypatch)
    saved(tmp_path / tiny_roma.NAME, {"one": Trap()})
    with pytest.raises(DataError, match="not the weights"):
        load_matcher(tmp_path)
    assert not (tmp_path / "run").exists()


def test_without_the_package_one_line_says_what_to_install(tmp_path, monkeypatch):
    saved(tmp_path / tiny_roma.NAME)
    monkeypatch.setitem(sys.modules, "romatch", None)
    with pytest.raises(
        MissingError, match=r"install splatproof\[priors\].*--no-deps romatch.*dense.matcher flow"
    ) as error:
        load_matcher(tmp_path)
    assert "\n" not in str(error.value)


NOISY = pytest.mark.filterwarnings("default")
"""What the library warns of differs with its version and is not ours."""


@NOISY
@pytest.mark.usefixtures("_no_network")
def test_the_real_tiny_network_finds_a_shift_between_photos_of_other_sizes(tmp_path):
    """Its features are random, so that some places go wrong; more go where they belong than anywhere else."""
    matcher = load_matcher(tiny_roma.tiny_folder(tmp_path))
    whole = tiny_roma.texture(*tiny_roma.SIZE)[0].permute(1, 2, 0)
    warp, certainty = matcher(whole[64:256, 96:352], whole)
    assert warp.shape == (192, 256, 2)
    assert not warp.is_inference()
    assert set(certainty.unique().tolist()) <= {0.0, 0.5}
    counted = Counter(map(tuple, warp[16:-16, 16:-16].reshape(-1, 2).round().int().tolist()))
    assert counted.most_common(1)[0][0] == (96, 64)
    assert torch.equal(warp, matcher(whole[64:256, 96:352], whole)[0])


@NOISY
@pytest.mark.usefixtures("_no_network")
def test_weights_of_another_network_are_refused_by_the_real_class(tmp_path):
    tiny_roma.package()
    saved(tmp_path / tiny_roma.NAME)
    with pytest.raises(DataError, match="not the weights that are expected") as error:
        load_matcher(tmp_path)
    assert "\n" not in str(error.value)


@NOISY
@pytest.mark.slow
@pytest.mark.usefixtures("_no_network")
def test_the_real_whole_network_is_understood(tmp_path, monkeypatch):
    """With random weights, one block of DINOv2's 24, and small sizes; as it is, a pair takes a minute or more."""
    tiny_roma.package()
    transformer = importlib.import_module("romatch.models.transformer")
    dino, block = transformer.dinov2.DinoVisionTransformer, transformer.dinov2.Block
    block = partial(block, attn_class=transformer.MemEffAttention)
    monkeypatch.setattr(
        transformer, "vit_large",
        partial(dino, embed_dim=1024, depth=1, num_heads=16, mlp_ratio=4, block_fn=block),
    )  # fmt: skip
    monkeypatch.setattr(torch.nn.Module, "load_state_dict", lambda *given, **more: None)
    for name in ("roma_outdoor.pth", roma.BACKBONE):
        saved(tmp_path / name)
    matcher = load_matcher(tmp_path)
    network = matcher._network
    network.h_resized = network.w_resized = 112
    network.upsample_res = (128, 128)
    warp, certainty = matcher(torch.rand(75, 100, 3), torch.rand(60, 120, 3))
    assert warp.shape == (75, 100, 2)
    assert certainty.shape == (75, 100)
    assert warp.isfinite().all()
    assert 0 <= certainty.min() <= certainty.max() <= 1
    said, _ = network.match(*(roma.picture(torch.rand(64, 96, 3), None) for _ in range(2)))
    assert said.shape == (1, 128, 128, 4)
    assert_close(said[0, ..., :2].double(), 2 * middles(128, 128) / 128 - 1, atol=1e-6, rtol=0)
