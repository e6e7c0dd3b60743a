"""Whether the rows of a table may be compared: truth, split, and where they were measured."""

from collections.abc import Sequence, Sized

from splatproof.reference.types.result import Result

DATA = ("model_sha256", "cameras_sha256", "photos_sha256", "files_sha256")
"""Facts of a scene that name its files, and nothing of code or machine."""
MIN_SEEDS = 3
"""A row with fewer seeds is shown but not ranked."""


def truth_faults(results: Sequence[Result]) -> list[str]:
    """Why the scores of one scene must not be compared; empty when they may be.

    Args:
        results: Finished ones of one scene under one protocol.
    Returns: One line a kind of fault, naming an example: other test images, other pixels of the
        same image, another split, other files under the scene's name.
    """
    if not results:
        return []
    first, faults = results[0], []
    for result in results[1:]:
        faults += [
            f"{text}, so no row of {first.scene} is ranked: {_name(first)} and {_name(result)}"
            for text in _faults(first, result)
        ]
    return faults[:3]


def _faults(one: Result, other: Result) -> list[str]:
    hashes = [{image.name: image.truth_sha256 for image in r.images} for r in (one, other)]
    odd = sorted(hashes[0].keys() ^ hashes[1].keys())
    if odd:
        return [f"test images differ ({odd[0]} was scored in one only)"]
    changed = sorted(name for name in hashes[0] if hashes[0][name] != hashes[1][name])
    if changed:
        return [f"truth pixels differ in {len(changed)} images, e.g. {changed[0]}"]
    if one.split_sha256 != other.split_sha256:
        return ["the training images differ"]
    facts = one.scene_facts, other.scene_facts
    files = [
        name for name in DATA if all(name in f for f in facts) and facts[0][name] != facts[1][name]
    ]
    return [f"the scene's files differ ({', '.join(files)})"] if files else []


def _name(result: Result) -> str:
    return f"{result.row} seed {result.seed}"


def environment_notes(results: Sequence[Result]) -> list[str]:
    """A line naming what differs between the machines and versions that results come from."""
    names = {name: None for result in results for name in result.environment}
    odd = [n for n in names if len({result.environment.get(n) for result in results}) > 1]
    if not odd:
        return []
    where = f"measured in different environments (other {', '.join(odd)})"
    return [f"{where}: times and memory are not comparable between them"]


def unranked_reason(seeds: Sized, rules: dict[str, object]) -> str:
    """Why a row is not ranked, whatever the other rows are; empty when it may be.

    Args:
        seeds: The finished ones of the row.
        rules: Of their protocol.
    """
    if rules.get("appearance") == "oracle":
        return "unranked: oracle appearance"
    if len(seeds) < MIN_SEEDS:
        return f"unranked: {len(seeds)} seed{'' if len(seeds) == 1 else 's'}"
    return ""
