"""Hashes of a small view of some worlds and of a church's triangles: run as a script it prints them."""

import hashlib
from dataclasses import replace

from splatproof.datasets.procedural import aerial, ray_images, worlds
from splatproof.reference.types.camera import Camera


def smaller(camera: Camera) -> Camera:
    """The same view in a ninth of the pixels."""
    scale = camera.K.new_tensor([[1 / 3], [1 / 3], [1]])
    width, height = camera.width // 3, camera.height // 3
    return replace(camera, K=camera.K * scale, width=width, height=height)


def hashes() -> list[str]:
    """A world or part of one, and its hash, one after the other."""
    found = []
    for world in ("tunnel", "street", "courtyard"):
        plan = worlds.plan(world, "small", 0)
        shot = plan.shots[0]
        stage = plan.stage(shot)
        frame = ray_images.take(
            stage.caster, stage.lighting, smaller(shot.camera), samples=2, seed=3,
            exposure=stage.exposure, seeds=stage.object_seeds,
        )  # fmt: skip
        found += [world, hashlib.sha256(frame.colour.tobytes()).hexdigest()]
    church = aerial.church(0)
    for part in (church.vertices, church.normals, church.coords):
        found += ["church", hashlib.sha256(part.tobytes()).hexdigest()]
    return found


if __name__ == "__main__":
    print(*hashes())
