"""Training views with depth priors: each made once, kept in the cache folder, read when asked for."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.base.files import read_json, write_text
from splatproof.base.locks import locked
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.datasets.cache_folder import ELSEWHERE, cache_folder
from splatproof.methods.contracts.run import keep_to_oneself
from splatproof.methods.priors.kinds import KINDS, Kind, parts, weights_facts
from splatproof.reference.types.result import NO_PRIOR, prior_name
from splatproof.reference.types.scene import DepthPrior, Scene

VERSION = 1
"""Changes when other priors would come out of equal views."""
SUMMARY = "facts.json"
SILENT = "depth_prior_silent"
"""The fact of a record that names the views of which the prior says nothing."""
REMEDY = "remove it, and the next run makes it again"
"""What to do about a damaged file of priors."""
Report = Callable[[int, int], None]


def with_priors(
    scene: Scene,
    prior: str,
    seed: int,
    data: str = "",
    report: Report = lambda done, total: None,
    say: Callable[[str], None] = keep_to_oneself,
) -> Scene:
    """The scene with a depth prior on each training view; held-out views get none.

    Priors are kept in the cache folder, a file a view, each there whole or not at all: a run that
    was killed goes on with the view it was at. They are made again where the scene's files, its
    cameras, their size or split, the kind, its weights or (where it draws) the seed differ.

    Args:
        scene: The scene with its truth, of which only kinds that say so get to see any.
        prior: "none", which returns the scene itself, or what `kinds.resolved` made.
        seed: Seed of the case.
        data: Hash of the scene's files, see `splatproof.datasets.fingerprint`; "": there are none
            or they were not read, and images, masks, depths and sweeps are hashed instead.
        report: Told (views that have their prior, views in all).
        say: Told one line where nothing is said of some views.
    Returns: The scene; its facts name the kind, the hashes of weights and priors, the share of
        valid pixels, and views of which nothing is said.
    Raises: UsageError where the scene lacks what the kind needs; MissingError without its weights.
    """
    if prior == NO_PRIOR:
        return scene
    name, path = parts(prior)
    kind, weights = KINDS[name], weights_facts(prior)
    shown = scene if kind.truth else scene.for_training()
    make = kind.prepare(shown, path, seed)
    folder = cache_folder() / "priors" / _key(scene, name, kind, weights, seed, data)
    files = {index: folder / f"{index:06d}.safetensors" for index in scene.train}
    with locked(folder.with_suffix(".lock"), elsewhere=ELSEWHERE):
        for done, (index, file) in enumerate(files.items()):
            report(done, len(files))
            if not file.is_file():
                _write(file, make(index))
        report(len(files), len(files))
        if not (folder / SUMMARY).is_file():
            named = {scene.views[index].name: file for index, file in files.items()}
            write_text(folder / SUMMARY, json.dumps(_summary(named)))
    views = list(scene.views)
    for index, file in files.items():
        views[index] = replace(views[index], load_prior=partial(read_prior, file))
    facts = {"depth_prior": prior_name(prior)} | weights | _facts(folder / SUMMARY)
    if kind.domain is not None and path is not None:
        facts["depth_prior_domain"] = kind.domain(scene, path)
    if SILENT in facts:
        why = f": {kind.silent}" if kind.silent else ""
        say(f"depth prior {name!r} says nothing of {facts[SILENT]}{why}")
    return replace(scene, views=tuple(views), facts=scene.facts | facts)


def read_prior(file: Path) -> DepthPrior:
    """The prior of one view.

    Raises: DataError naming a file that is missing or damaged.
    """
    tensors, _ = read_tensors(file, REMEDY)
    if set(tensors) != {"disparity", "valid"}:
        raise DataError(
            f"{file}: holds {', '.join(sorted(tensors)) or 'nothing'}, expected disparity and valid; "
            f"{REMEDY}"
        )
    return DepthPrior(**tensors)


def _facts(file: Path) -> dict[str, str]:
    """What `_summary` said of the priors beside the file."""
    try:
        held = read_json(file)
    except DataError as error:
        raise DataError(f"{error}; {REMEDY}") from None
    if not isinstance(held, dict):
        raise DataError(f"{file}: holds no facts of priors; {REMEDY}")
    return held


def _write(file: Path, prior: DepthPrior) -> None:
    write_tensors(file, {"disparity": prior.disparity, "valid": prior.valid})


def _summary(files: Mapping[str, Path]) -> dict[str, str]:
    """Hash of all priors, by name of their view; the mean share of pixels of which they say anything; and the views of
    which they say nothing."""
    digest, share, silent = hashlib.sha256(), 0.0, []
    for name, file in files.items():
        prior = read_prior(file)
        digest.update(prior.disparity.numpy().tobytes() + prior.valid.numpy().tobytes())
        share += float(prior.valid.float().mean()) / len(files)
        if not bool(prior.valid.any()):
            silent.append(name)
    found = {"depth_prior_sha256": digest.hexdigest(), "depth_prior_valid": f"{share:.4f}"}
    return found | ({SILENT: ", ".join(silent)} if silent else {})


def _key(
    scene: Scene, name: str, kind: Kind, weights: Mapping[str, str], seed: int, data: str
) -> str:
    """Hash of all that the priors depend on."""
    facts = {key: value for key, value in scene.facts.items() if key.endswith("sha256")}
    drawn = seed if kind.draws else None
    digest = hashlib.sha256(
        json.dumps([VERSION, name, weights, drawn, data, facts], sort_keys=True).encode()
    )
    for index in scene.train:
        view = scene.views[index]
        digest.update(f"{index} {view.name} {view.camera.width} {view.camera.height}".encode())
        digest.update(view.camera.K.numpy().tobytes())
        digest.update(view.camera.world_to_camera.numpy().tobytes())
        if not data:
            digest.update(view.load().numpy().tobytes())
            digest.update(b"" if view.load_mask is None else view.load_mask().numpy().tobytes())
            digest.update(b"" if view.load_depth is None else view.load_depth().numpy().tobytes())
            digest.update(
                b"" if view.load_sweep is None else view.load_sweep().positions.numpy().tobytes()
            )
    digest.update(scene.points.positions.numpy().tobytes())
    digest.update(scene.points.track_views.numpy().tobytes())
    return digest.hexdigest()[:32]
