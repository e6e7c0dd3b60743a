"""`bench score`: from two folders to a table, JSON lines, or one line for each fault."""

import json
import math

import numpy as np
import pytest
import torch
from PIL import Image

from helpers.images import noise_image, random_mask, spoiled
from splatproof.cli import main
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.scoring import scene_metrics, score_image


def save(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((image * 255).round().to(torch.uint8).numpy()).save(path)


@pytest.fixture
def folders(tmp_path):
    """Two views, one of them in a folder."""
    for index, name in enumerate(("a", "cam1/b")):
        truth = torch.round(noise_image(30, 40, index) * 255) / 255
        save(tmp_path / "truth" / f"{name}.png", truth)
        save(tmp_path / "renders" / f"{name}.png", spoiled(truth, 0.05, index))
        mask = random_mask(30, 40, 0.8, index)[..., None].expand(30, 40, 3).float()
        save(tmp_path / "masks" / f"{name}.png", mask)
    (tmp_path / "renders" / "notes.txt").write_text("not an image")
    return tmp_path


def read(path):
    return torch.from_numpy(np.array(Image.open(path))).float() / 255


def run(folders, capsys, *options):
    code = main(["score", str(folders / "renders"), str(folders / "truth"), *options])
    said = capsys.readouterr()
    return code, said.out, said.err.splitlines()


def test_json_lines_are_what_the_library_scores(folders, capsys):
    options = [
        "--protocol",
        "default,3dgs",
        "--scene",
        "s",
        "--method",
        "m",
        "--seed",
        "3",
        "--json",
    ]
    code, out, _ = run(folders, capsys, *options)
    lines = [json.loads(line) for line in out.splitlines()]
    want = []
    for name in ("default", "3dgs"):
        images = [
            score_image(
                f"{view}.png",
                read(folders / "renders" / f"{view}.png"),
                read(folders / "truth" / f"{view}.png"),
                load_protocol(name),
            )
            for view in ("a", "cam1/b")
        ]
        label = {"scene": "s", "method": "m", "seed": 3, "protocol": name}
        want += [
            label
            | {"image": i.name, "truth_sha256": i.truth_sha256, "valid_share": 1.0}
            | i.metrics
            for i in images
        ]
        want.append(label | {"image": None} | scene_metrics(images))
    assert code == 0
    assert lines == want


def test_the_table_shows_each_image_and_the_mean(folders, capsys):
    code, out, _ = run(folders, capsys, "--masks", str(folders / "masks"))
    _, lines, _ = run(folders, capsys, "--masks", str(folders / "masks"), "--json")
    records = [json.loads(line) for line in lines.splitlines()]
    assert code == 0
    assert "valid" in out
    for record in records:
        assert f"{record['psnr']:.4f}" in out
    assert f"psnr_of_mean_mse {records[-1]['psnr_of_mean_mse']:.4f}" in out


def test_masks_say_what_counts(folders, capsys):
    _, out, _ = run(folders, capsys, "--masks", str(folders / "masks"), "--json")
    first = json.loads(out.splitlines()[0])
    mask = read(folders / "masks" / "a.png")[..., 0] > 0
    want = score_image(
        "a.png",
        read(folders / "renders" / "a.png"),
        read(folders / "truth" / "a.png"),
        load_protocol("default"),
        mask,
    )
    assert first["valid_share"] == pytest.approx(float(mask.double().mean()))
    assert {key: first[key] for key in want.metrics} == want.metrics


def test_masks_may_carry_the_whole_name(folders, capsys):
    for path in list((folders / "masks").rglob("*.png")):
        path.rename(path.with_name(f"{path.name}.png"))
    code, *_ = run(folders, capsys, "--masks", str(folders / "masks"))
    assert code == 0


def test_equal_images_are_null_in_json_and_inf_for_people(folders, capsys):
    _, out, _ = run(folders, capsys, "--protocol", "3dgs")
    assert "inf" not in out
    arguments = ["score", str(folders / "truth"), str(folders / "truth")]
    assert main([*arguments, "--json"]) == 0
    record = json.loads(capsys.readouterr().out.splitlines()[0])
    assert record["psnr"] is None
    assert math.isclose(record["ssim_3dgs"], 1)
    assert main(arguments) == 0
    assert "inf" in capsys.readouterr().out


def cut_short(folders):
    path = folders / "renders" / "a.png"
    path.write_bytes(path.read_bytes()[:2000])
    return [str(path), "not a readable image"]


def not_an_image(folders):
    (folders / "renders" / "a.png").write_text("hello")
    return ["renders/a.png", "not a readable image"]


def empty_file(folders):
    (folders / "truth" / "a.png").write_bytes(b"")
    return ["truth/a.png", "not a readable image"]


def wrong_size(folders):
    save(folders / "renders" / "a.png", noise_image(30, 41, 0))
    return ["renders/a.png: is 41 x 30 px but", "truth/a.png is 40 x 30"]


def sixteen_bit(folders):
    Image.fromarray(np.zeros((30, 40), dtype=np.uint16)).save(folders / "renders" / "a.png")
    return ["renders/a.png", "expected 8-bit"]


def transparent(folders):
    Image.new("RGBA", (40, 30), (0, 0, 0, 9)).save(folders / "renders" / "a.png")
    return ["renders/a.png", "transparent"]


def missing(folders):
    (folders / "renders" / "a.png").unlink()
    return ["truth/a.png: no render of that name in", "renders"]


def left_over(folders):
    save(folders / "renders" / "c.png", noise_image(30, 40, 0))
    return ["renders/c.png: no truth of that name"]


def no_mask(folders):
    (folders / "masks" / "a.png").unlink()
    return ["truth/a.png: no mask of that name in", "masks"]


def mask_of_another_size(folders):
    save(folders / "masks" / "a.png", noise_image(10, 40, 0))
    return ["masks/a.png: is 40 x 10 px but"]


def black_mask(folders):
    save(folders / "masks" / "a.png", torch.zeros(30, 40, 3))
    return ["a.png: no valid pixel"]


def too_small(folders):
    for folder in ("renders", "truth", "masks"):
        save(folders / folder / "a.png", torch.ones(10, 40, 3))
    return ["a.png: ssim_3dgs: image is 40 x 10 px", "11 x 11 px window"]


@pytest.mark.parametrize(
    "spoil",
    [
        cut_short, not_an_image, empty_file, wrong_size, sixteen_bit, transparent, missing, left_over,
        no_mask, mask_of_another_size, black_mask, too_small,
    ],
)  # fmt: skip
def test_each_fault_is_one_line_and_nothing_is_printed(folders, capsys, spoil):
    said = spoil(folders)
    code, out, errors = run(folders, capsys, "--masks", str(folders / "masks"), "--json")
    assert code == 2
    assert out == ""
    assert len(errors) == 2
    assert all(part in errors[0] for part in said)
    assert "Traceback" not in errors[0]


def test_all_faults_are_named_at_once(folders, capsys):
    for spoil in (left_over, wrong_size):
        spoil(folders)
    (folders / "renders" / "cam1" / "b.png").unlink()
    code, _, errors = run(folders, capsys)
    assert code == 2
    assert len(errors) == 4
    assert errors[-1] == "bench: 3 problems, named above; nothing was scored"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--protocol", "defualt"], "unknown 'defualt', did you mean 'default'"),
        (["--protocol", "default,default"], "one name stands twice"),
        (["--protocol", "default,"], "unknown ''"),
        (["--masks", "nowhere"], "nowhere: no such folder"),
    ],
)
def test_bad_options_are_refused(folders, capsys, options, said):
    code, out, errors = run(folders, capsys, *options)
    assert (code, out) == (2, "")
    assert len(errors) == 1
    assert said in errors[0]


def test_missing_weights_are_told_before_any_work(folders, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    path = tmp_path / "learned.toml"
    path.write_text('source = "me"\nmetrics = ["psnr", "lpips_vgg_01"]\n')
    code, out, errors = run(folders, capsys, "--protocol", str(path))
    assert (code, out) == (3, "")
    assert len(errors) == 1
    assert "vgg16-397923af.pth are not in" in errors[0]


def test_folders_without_images_or_with_two_of_a_name(folders, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["score", str(tmp_path / "empty"), str(folders / "truth")]) == 2
    assert "empty: holds no image" in capsys.readouterr().err
    save(folders / "renders" / "a.jpg", noise_image(30, 40, 0))
    code, _, errors = run(folders, capsys)
    assert code == 2
    assert "a.jpg and a.png differ only by suffix" in errors[0]


def test_jpeg_is_matched_by_stem(folders, capsys):
    path = folders / "truth" / "a.png"
    Image.open(path).save(path.with_suffix(".jpg"), quality=95)
    path.unlink()
    code, out, _ = run(folders, capsys, "--json")
    assert code == 0
    assert json.loads(out.splitlines()[0])["image"] == "a.jpg"


def test_progress_on_a_terminal_does_not_disturb_stdout(folders, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    code, out, _ = run(folders, capsys, "--json")
    assert code == 0
    assert [json.loads(line)["image"] for line in out.splitlines()] == ["a.png", "cam1/b.png", None]
