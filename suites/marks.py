"""Time to quality: the model as it was after so many seconds, kept while it trains and scored later."""

import pickle
import shutil
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from splatproof.base.files import write_bytes
from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.methods.contracts.run import show_nobody
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.training.snapshots import pickled
from splatproof.metrics.scoring import score_image
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene
from splatproof.suites.held_out import drawn, kept, scored_views

FOLDER = "marks"
"""Folder of a case in which its models lie until they are scored."""
SHARE = 0.95
"""Share of the final gain in PSNR whose time is told."""
Timed = tuple[tuple[float, dict[str, float]], ...]
"""(seconds, mean of each metric) of each mark, by seconds."""


class Marks:
    """Called while a model trains: keeps it at the first report after each mark.

    What writing takes is not counted.
    """

    def __init__(
        self,
        folder: Path,
        marks: Sequence[float],
        before: float,
        then: Callable[[int, int, Model], None] = show_nobody,
    ) -> None:
        """Start the clock.

        Args:
            folder: Folder of the case; models that lie there already are kept.
            marks: Wall seconds, rising.
            before: Seconds that the case had taken when the clock starts.
            then: Called with the same step, total and model afterwards.
        """
        self._folder = folder / FOLDER
        self._due = [mark for mark in marks if not self._path(mark).exists()]
        self._began = time.perf_counter() - before
        self._then = then

    def _path(self, mark: float) -> Path:
        return self._folder / f"{mark:g}.pickle"

    def __call__(self, step: int, total: int, model: Model) -> None:
        """Keep the model for every mark that has passed.

        Args:
            step: Training steps that are done.
            total: Training steps of the whole run.
            model: What is kept; only read here.
        """
        paused = time.perf_counter()
        now = paused - self._began
        passed = [mark for mark in self._due if mark <= now]
        for mark in passed:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_bytes(self._path(mark), pickled((now, step, model)))
            self._due.remove(mark)
        self._then(step, total, model)
        if passed:
            self._began += time.perf_counter() - paused


def timed_scores(
    folder: Path,
    marks: Sequence[float],
    scene: Scene,
    protocol: Protocol,
    backend: str,
    final: Mapping[str, float],
) -> Timed:
    """Mean of each of the protocol's metrics at each mark; the models are removed afterwards.

    A mark at which training was over has the final model's.

    Args:
        folder: Folder of the case.
        marks: Wall seconds, rising.
        scene: With test views.
        protocol: The rules.
        backend: Name of the rasterizer.
        final: Mean of each metric of the final model.
    """
    known = {name: final[name] for name in protocol.metrics if name in final}
    found = []
    for mark in marks:
        path = folder / FOLDER / f"{mark:g}.pickle"
        if not path.exists():
            found.append((float(mark), known))
            continue
        seconds, _, model = pickle.loads(path.read_bytes())  # our own folder, written by this case
        shown = DecodedModel.of("at a mark", model, scene, backend)
        found.append((round(seconds, 3), _means(scene, shown, protocol)))
    shutil.rmtree(folder / FOLDER, ignore_errors=True)
    return tuple(found)


def timed_metrics(marks: Sequence[float], timed: Timed) -> dict[str, float]:
    """What tables show of the marks: NAME_<mark>s at each, and time_to_95.

    Args:
        marks: Wall seconds, rising.
        timed: Scores at each.
    """
    named = {
        f"{name}_{mark:g}s": value
        for mark, (_, means) in zip(marks, timed, strict=True)
        for name, value in means.items()
    }
    return named | ({"time_to_95": seconds_to(timed)} if len(timed) > 1 else {})


def seconds_to(timed: Timed, share: float = SHARE) -> float:
    """Seconds after which a share of the gain in PSNR from the first to the last mark is reached for good.

    Linear between marks; nan where PSNR is not scored.

    Args:
        timed: Scores at each mark.
        share: Share of the gain, 0 to 1.
    """
    if any("psnr" not in means for _, means in timed):
        return float("nan")
    points = [(seconds, means["psnr"]) for seconds, means in timed]
    goal = points[0][1] + share * (points[-1][1] - points[0][1])
    last = max((i for i, (_, value) in enumerate(points) if value < goal), default=-1)
    if last == -1 or last + 1 == len(points):
        return points[0][0] if last == -1 else points[-1][0]
    (t0, v0), (t1, v1) = points[last], points[last + 1]
    return t0 + (goal - v0) / (v1 - v0) * (t1 - t0)


def _means(scene: Scene, model: Reconstruction, protocol: Protocol) -> dict[str, float]:
    scores = []
    for view in scored_views(scene, protocol):
        render, _ = kept(drawn(view, scene.train_views, model, protocol), protocol.rounding)
        truth, _ = kept(view.load(), "float")
        mask = None if view.load_mask is None else view.load_mask()
        scores.append(score_image(view.name, render, truth, protocol, mask).metrics)
    return {
        name: statistics.fmean(score[name] for score in scores)
        for name in protocol.metrics
        if all(name in score for score in scores)
    }
