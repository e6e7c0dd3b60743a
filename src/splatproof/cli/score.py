"""`bench score RENDERS TRUTH`: anybody's images, or a model's, against the truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import tyro

from splatproof.cli import output
from splatproof.cli.score_model import is_model, render_cameras, score_held_out

if TYPE_CHECKING:
    from torch import Tensor

    from splatproof.reference.types.protocol import Protocol
    from splatproof.reference.types.result import ImageScore


@dataclass(frozen=True, kw_only=True)
class Trio:
    """The files of one view."""

    name: str
    """File name of the truth relative to its folder."""
    render: Path
    truth: Path
    mask: Path | None
    """White where a pixel counts; None: all count."""


def score(
    renders: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RENDERS")],
    truth: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[TRUTH]")] = None,
    *,
    protocol: str | None = None,
    masks: Path | None = None,
    scene: str | None = None,
    method: str | None = None,
    seed: int | None = None,
    cameras: Path | None = None,
) -> int:
    """Score a folder of images against a folder of true ones, file by file.

    Files are matched by their path in the folder without the suffix (PNG, JPEG, TIFF; 8 bit, or 16
    bit RGB as PNG). Where TRUTH is the truth/ of a finished case (`bench fit`, `bench run`) and
    nothing else is asked for, its protocol and its masks/ are used; with its renders/ that gives the
    image scores of its record again to the last digit. Every file is looked at before anything is
    scored, and each that is missing, left over, unreadable or of another size is named. Only the
    scoring rules of a protocol apply (rounding, masks, region, metrics, colour fits); which images
    there are, and their sizes, is what the folders hold. Scores of parts (moving_psnr, seen_psnr) need
    the scene and are not given.

    RENDERS may be a trained model instead: a folder that `bench fit` wrote, or a .ply, .spz, .sog, .glb or
    packed file. Its pictures of a scene's held-out views are scored then, with their parts, where
    --scene and --protocol say which (a model of ours knows them); or, with --cameras and TRUTH, its
    pictures of the file's cameras against images of the same names.

    With --json each image is a line: scene, method, seed, protocol, image, truth_sha256,
    valid_share and every metric by its name; then a line with image null: the mean of each over the
    images, and psnr_of_mean_mse. Values that are not finite are null.

    Args:
        renders: Folder of the images to score, or a model.
        truth: Folder of the true images, of the same sizes; left out where a scene's held-out views
            are the truth of a model.
        protocol: Names of protocols or paths of .toml files, with commas between them; every one
            gives a table of its own. None: that of the case that TRUTH belongs to, else default.
        masks: Folder of masks, white where a pixel counts, one for each truth: of the same path
            without the suffix, or the truth's whole name with another suffix behind it. None: the
            masks of the case where its protocol is used, else all pixels count.
        scene: Name of the scene, for the output alone. Of a model: name or folder of the scene whose
            held-out views are scored; None: its own.
        method: Name of what made the renders, for the output alone.
        seed: Seed of what made the renders, for the output alone.
        cameras: With a model and TRUTH: the .json file of cameras, as `bench render` reads it.
    """
    from splatproof.base.errors import UsageError
    from splatproof.metrics.protocol_files import load_protocol
    from splatproof.metrics.registry import load_weights
    from splatproof.metrics.scoring import scene_metrics

    label = {"scene": scene, "method": method, "seed": seed}
    if truth is None:
        if not is_model(renders):
            raise UsageError(
                f"{renders}: is no model; say TRUTH, the folder of the true images, behind it"
            )
        if cameras is not None or masks is not None:
            raise UsageError(
                "--cameras and --masks belong to TRUTH, a folder of true images; name it"
            )
        named, rule, held = score_held_out(renders, scene, protocol)
        _print_scores(label | {"scene": named}, rule, held, scene_metrics(held))
        return 0
    if (cameras is not None) != is_model(renders):
        raise UsageError(
            f"{renders}: a model is scored against TRUTH from the cameras of a file, and only a model "
            "is: give --cameras with a model alone"
        )
    if cameras is not None:
        with TemporaryDirectory() as folder:
            render_cameras(renders, cameras, protocol, Path(folder))
            return score(Path(folder), truth, protocol=protocol, masks=masks, **label)
    own = _of_case(truth) if protocol is None else None
    if own is not None:
        rules = [own]
        output.log(f"protocol {own.name}, as in the record of {truth.parent}")
        inner = truth.parent / "masks"
        masks = inner if masks is None and inner.is_dir() else masks
    else:
        rules = [load_protocol(name.strip()) for name in (protocol or "default").split(",")]
    if len({rule.name for rule in rules}) < len(rules):
        raise UsageError(f"--protocol {protocol}: one name stands twice")
    load_weights(metric for rule in rules for metric in rule.metrics)
    scores = _score_all(_trios(renders, truth, masks), rules)
    for rule in rules:
        images = scores[rule.name]
        _print_scores(label, rule, images, scene_metrics(images))
    return 0


def _print_scores(
    label: Mapping[str, object], rule: "Protocol", images: "Sequence[ImageScore]",
    means: Mapping[str, float],
) -> None:  # fmt: skip
    """Everything that was scored under a protocol, as lines of JSON or as a table."""
    if output.wants_json():
        for line in _lines(images, means):
            output.print_record({**label, "protocol": rule.name, **line})
        return
    named = [f"{key} {value}" for key, value in label.items() if value is not None]
    title = ", ".join([*named, f"protocol {rule.name}", f"{len(images)} images"])
    _print_table(title, images, means)


def _of_case(truth: Path) -> "Protocol | None":
    """The protocol of the finished case whose truth/ this is; None where it is none's.

    Raises: DataError if the case's record is damaged.
    """
    from splatproof.metrics.protocol_files import protocol_from_rules
    from splatproof.suites.records import RECORD_NAME, read_record

    if truth.name != "truth" or not (truth.parent / RECORD_NAME).is_file():
        return None
    rules = dict(read_record(truth.parent).protocol_rules)
    source = str(truth.parent / RECORD_NAME)
    return protocol_from_rules(str(rules.pop("name")), rules, source)


def _trios(renders: Path, truth: Path, masks: Path | None) -> list[Trio]:
    """The files of each view, sorted by name, all of them readable and of one size.

    Raises: DataError after naming on stderr, one line each, every file that does not fit.
    """
    from splatproof.base.errors import DataError

    shown, true = _by_key(renders), _by_key(truth)
    valid = None if masks is None else _by_key(masks)
    problems = [f"{renders / shown[key]}: no truth of that name" for key in shown.keys() - true]
    found = []
    for key, name in true.items():
        mask = None if valid is None else valid.get(key, valid.get(name))
        if key not in shown:
            problems.append(f"{truth / name}: no render of that name in {renders}")
        elif valid is not None and mask is None:
            problems.append(f"{truth / name}: no mask of that name in {masks}")
        else:
            where = None if masks is None or mask is None else masks / mask
            files = Trio(name=name, render=renders / shown[key], truth=truth / name, mask=where)
            found.append(files)
    with output.progress() as bar:
        task = bar.add_task("check", total=len(found), values="")
        for trio in found:
            problems += _problems(trio)
            bar.advance(task)
    if problems:
        for problem in sorted(problems):
            output.warn(problem)
        raise DataError(f"{len(problems)} problems, named above; nothing was scored")
    return sorted(found, key=lambda trio: trio.name)


def _by_key(folder: Path) -> dict[str, str]:
    """Relative path without suffix -> relative path, of every image below the folder."""
    from splatproof.base.errors import DataError
    from splatproof.datasets.photos import list_photos

    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder, expected one of images")
    names = list_photos(folder)
    if not names:
        raise DataError(f"{folder}: holds no image, expected .png or .jpg files")
    keys: dict[str, str] = {}
    for name in names:
        key = str(Path(name).with_suffix(""))
        if key in keys:
            raise DataError(f"{folder}: {keys[key]} and {name} differ only by suffix; remove one")
        keys[key] = name
    return keys


def _problems(trio: Trio) -> Iterator[str]:
    """What is wrong with the files of a view; decodes each of them."""
    from splatproof.base.errors import DataError
    from splatproof.datasets.photos import read_photo

    sizes: dict[Path, Sequence[int]] = {}
    for path in (trio.truth, trio.render, trio.mask):
        if path is not None:
            try:
                sizes[path] = read_photo(path).shape
            except DataError as error:
                yield str(error)
    if trio.truth in sizes:
        height, width, _ = sizes.pop(trio.truth)
        for path, size in sizes.items():
            if tuple(size[:2]) != (height, width):
                yield (
                    f"{path}: is {size[1]} x {size[0]} px but {trio.truth} is {width} x {height}; "
                    "both must have the same size"
                )


def _score_all(trios: Sequence[Trio], rules: "Sequence[Protocol]") -> "dict[str, list[ImageScore]]":
    """Scores by protocol, one view's images in memory at a time.

    Raises: DataError after naming on stderr, one line each, every view that cannot be scored.
    """
    from splatproof.base.errors import DataError
    from splatproof.datasets.photos import read_photo
    from splatproof.metrics.scoring import score_image

    scores: dict[str, list[ImageScore]] = {rule.name: [] for rule in rules}
    failed = 0
    with output.progress() as bar:
        task = bar.add_task("score", total=len(trios), values="")
        for trio in trios:
            bar.update(task, values=trio.name)
            render, truth = read_photo(trio.render), read_photo(trio.truth)
            mask = None if trio.mask is None else _read_mask(trio.mask)
            try:
                for rule in rules:
                    scores[rule.name].append(score_image(trio.name, render, truth, rule, mask))
            except DataError as error:
                output.warn(str(error))
                failed += 1
            bar.advance(task)
    if failed:
        raise DataError(f"{failed} of {len(trios)} images cannot be scored, named above")
    return scores


def _read_mask(path: Path) -> "Tensor":
    """True where the mask is white: at least half of full brightness."""
    from splatproof.datasets.photos import read_photo

    return read_photo(path).mean(dim=2) >= 0.5


def _lines(
    images: "Sequence[ImageScore]", means: Mapping[str, float]
) -> Iterator[dict[str, object]]:
    """One record an image, then that of the mean."""
    for image in images:
        yield {
            "image": image.name,
            "truth_sha256": image.truth_sha256,
            "valid_share": image.valid_share,
            **image.metrics,
        }
    yield {"image": None, **means}


def _print_table(title: str, images: "Sequence[ImageScore]", means: Mapping[str, float]) -> None:
    """A table on stdout: one row an image, the mean below."""
    from rich.console import Console
    from rich.table import Table

    masked = any(image.valid_share < 1 for image in images)
    table = Table(title=title)
    table.add_column("image", no_wrap=True)
    for name in (*(["valid"] if masked else []), *images[0].metrics):
        table.add_column(name, justify="right", no_wrap=True)
    for image in images:
        share = [f"{image.valid_share:.1%}"] if masked else []
        table.add_row(image.name, *share, *(f"{value:.4f}" for value in image.metrics.values()))
    table.add_section()
    shown = [f"{means[name]:.4f}" for name in images[0].metrics]
    table.add_row("mean", *([""] if masked else []), *shown)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = 1000  # a pipe has no width to fold to
    console.print(table)
    for name, value in means.items():
        if name not in images[0].metrics:
            console.print(f"{name} {value:.4f}", markup=False)
