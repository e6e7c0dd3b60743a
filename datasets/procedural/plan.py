"""What a made scene consists of: its views, and the lit world that each of them sees."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

import numpy as np
from jaxtyping import Float

from splatproof.datasets.procedural.ray_images import Lighting
from splatproof.datasets.procedural.tracing import Caster
from splatproof.reference.types.camera import Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """A lit world at one moment."""

    caster: Caster
    lighting: Lighting
    object_seeds: Float[np.ndarray, " objects"]
    """A number in [0, 1) for each object id, for textures."""
    exposure: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """One view of a plan."""

    name: str
    """Photo name, with its suffix .png."""
    camera: Camera
    time: float = 0.0
    """Seconds since the first view."""
    sensor: str = ""
    """Name of the camera where several are used."""
    group: str = ""
    """"": part of the scene; else the name of the folder inside it that gets the view: views
    for tests only, with a model of their own."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Everything that defines a made scene."""

    world: str
    settings: Mapping[str, object]
    """What was chosen, as plain values; with seed and code they name the content."""
    seed: int
    shots: tuple[Shot, ...]
    stage: Callable[[Shot], Stage]
    """The lit world of a shot. Called from several threads."""
    samples: int
    """Strata a pixel on each axis."""
    features: int = 400
    """Corners looked for in a view when the sparse points are drawn."""
    movable: Mapping[str, str] = field(default_factory=dict)
    """Kinds of objects that move and so never carry sparse points, each with the mask that shows it
    (splatproof.datasets.moving_masks.KINDS). Where there are any, sky/ has masks of the sky too."""
    driven: bool = False
    """Whether time passes: views.json says when and by which camera each view was taken."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Further facts for scene.toml."""
    kinds: Mapping[str, tuple[str, ...]]
    """What each object is, by object id, for each group of shots; "" stands for all not named."""

    extras: Callable[[Path], None] | None = None
    """Writes further truth into the scene folder once the views are there."""

    def kinds_of(self, group: str) -> tuple[str, ...]:
        """What each object is that the shots of a group see."""
        return self.kinds[group if group in self.kinds else ""]


def once(make: Callable[[], Stage]) -> Callable[[Shot], Stage]:
    """A stage that is the same for all shots, made when the first one asks."""
    lock, made = Lock(), []

    def stage(shot: Shot) -> Stage:
        with lock:
            if not made:
                made.append(make())
        return made[0]

    return stage


def object_seeds(count: int, seed: int) -> Float[np.ndarray, " objects"]:
    """A number in [0, 1) for each object id, for textures.

    Args:
        count: Number of object ids, the sky's 0 among them.
        seed: Another seed gives unrelated numbers.
    """
    return np.random.Generator(np.random.PCG64((seed, 77))).random(count)


def code_hash() -> str:
    """Sha256 over the sources that decide what a made scene looks like."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def content_hash(world: str, settings: Mapping[str, object], seed: int) -> str:
    """Twelve hex digits that name a made scene's content: world, settings, seed and code.

    Args:
        world: Name of the world.
        settings: What was chosen, as plain values.
        seed: The world's seed.
    """
    text = f"{world} {sorted(settings.items())!r} {seed} {code_hash()}"
    return hashlib.sha256(text.encode()).hexdigest()[:12]
