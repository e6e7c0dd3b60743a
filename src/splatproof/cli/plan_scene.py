"""`bench plan SCENE`: what method auto would do with a scene on this machine, and why."""

import shlex
from collections.abc import Sequence
from dataclasses import asdict

from rich.table import Table

from splatproof.base.inside import outside_is_allowed
from splatproof.base.plugin_files import plugin_files
from splatproof.cli import output
from splatproof.cli.scene_opening import Points, scene_rules, tell_left_out


def plan_scene(
    scene: str,
    *,
    seconds: float,
    megabytes: float,
    db: float,
    protocol: str,
    width: int | None,
    points: Points | None,
    strict: bool,
    seed: int,
    threads: int | None,
) -> int:
    """Measure, probe and print a table; nothing is trained to its end and nothing is written.

    Args:
        scene: Name of a registered scene, or a scene folder.
        seconds: Budget of wall seconds.
        megabytes: Bound on the saved model; 0: none.
        db: PSNR in dB at which training is to end, on photos that are kept back; 0: no such end.
        protocol: Rules by which the scene is opened.
        width: Width of the images in pixels; None: the protocol's.
        points: Where the sparse points come from; None: as the protocol says.
        strict: Whether a scene that names photos which are not there is refused.
        seed: Seed of the probe.
        threads: Threads of torch and the kernels; None: as many as torch takes.
    """
    from splatproof.base.memory import available_mb
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.methods.auto.fit import planned, remembering
    from splatproof.methods.auto.goal import keep_back
    from splatproof.methods.auto.photos import planned_photos, working
    from splatproof.methods.auto.settings import AutoSettings
    from splatproof.methods.auto.words import told
    from splatproof.methods.contracts.run import Run
    from splatproof.methods.training.image_room import image_allowance

    asked = AutoSettings(seconds=seconds, megabytes=megabytes, db=db)
    rules = scene_rules(protocol, width, points, strict)
    allowance = image_allowance(available_mb())  # as `bench fit` has it
    run = Run(seed=seed, background=rules.background, threads=threads, image_bytes=allowance)
    whole = open_scene(scene, rules)
    tell_left_out(whole)
    opened = whole.for_training()
    with output.progress() as bar:
        bar.add_task("measuring and probing", total=None)
        photos = planned_photos(opened, asked, run)
        seen = remembering(working(opened, photos), run.image_bytes)
        found = planned(keep_back(seen).scene if db else seen, asked, run, photos)
    if output.wants_json():
        output.print_record(
            {"scene": opened.name, "facts": asdict(found.facts), "seconds": found.plan.seconds,
             "choices": [asdict(choice) for choice in found.plan.choices],
             "settings": asdict(found.plan.settings)}
        )  # fmt: skip
        return 0
    output.print_table(_table(("measured", "", ""), told(found.facts, len(opened.points))))
    chosen = [(one.component, one.value, one.because, one.expects) for one in found.plan.choices]
    output.print_table(_table(("chosen", "", "because", "expected"), chosen))
    given = {
        "--seconds": f"{seconds:g}", "--megabytes": f"{megabytes:g}" if megabytes else "",
        "--db": f"{db:g}" if db else "", "--protocol": "" if protocol == "default" else protocol,
        "--width": str(width or ""), "--points": points or "", "--seed": str(seed or ""),
        "--threads": str(threads or ""),
    }  # fmt: skip
    words = ["bench", "fit", "auto", scene, "--out", "OUT"]
    words += [word for option, value in given.items() if value for word in (option, value)]
    words += [word for file in plugin_files() for word in ("--plugin", str(file.path))]
    words += ["--strict"] * strict + ["--allow-outside"] * outside_is_allowed()
    output.log(
        f"training would take about {found.plan.seconds:.0f} s; `{shlex.join(words)}` does it"
    )
    return 0


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(box=None, pad_edge=False)
    for head in heads:
        table.add_column(head, overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table
