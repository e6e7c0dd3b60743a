"""`bench plan`: what a scene asks for, or what a city takes on n machines, before anything is started."""

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import tyro

from splatproof.base.errors import UsageError
from splatproof.cli import output
from splatproof.cli.plan_scene import plan_scene
from splatproof.cli.scene_opening import Points

if TYPE_CHECKING:
    from splatproof.suites.city_plan import City, Plan

MACHINES = (1, 2, 4, 8, 16, 32, 64)
"""Numbers of machines that are planned for where nobody says which."""
WIDTH, HEIGHT = 1_600, 1_200
"""Pixels of a view of a city where nobody says."""
VIEWS, GAUSSIANS, ITERATIONS, REFINEMENT = 10_000, 100_000_000, 30_000, 7_000
"""A city's views and Gaussians, steps of a block and of the refinement, where nobody says."""
MARGIN, VIEWS_A_BLOCK = 0.15, 2.5
"""Blocks of a city where nobody says."""
CORES, MEMORY_GB = 16, 64.0
"""Machines where nobody says."""
HEADING = "blocks machines workers  block GB  block h  blocks h  serial h   wall h"


def plan(
    scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[SCENE]")] = "",
    *,
    seconds: float | None = None,
    megabytes: float | None = None,
    db: float | None = None,
    protocol: str | None = None,
    points: Points | None = None,
    strict: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    threads: int | None = None,
    views: int = VIEWS,
    gaussians: int = GAUSSIANS,
    width: int | None = None,
    height: int | None = None,
    iterations: int = ITERATIONS,
    refinement: int = REFINEMENT,
    margin: float = MARGIN,
    views_a_block: float = VIEWS_A_BLOCK,
    cores: int = CORES,
    memory_gb: float = MEMORY_GB,
    blocks: tuple[int, ...] = (),
    machines: tuple[int, ...] = (),
    every: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(name="all")] = False,
    simulate: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    spread: float | None = None,
    seed: int | None = None,
) -> int:
    """Plan the training of a scene; or of a city: block count, memory and time on n machines.

    With SCENE: what method auto would do with it in so many seconds. The scene is measured, this machine
    timed, and settings that may matter compete in short trainings on training views that they do not
    see; a table says what was chosen, and the measured fact behind each choice. With --json that is one
    object: facts, choices and settings. `bench fit auto SCENE` does the same and then trains.

    Without SCENE: a city, of which nothing is trained. Times are those of this package's CPU kernels; their constants stand, with how
    they were measured, in suites/city_plan.py and suites/estimate.py. With --json each plan is a
    line: blocks, machines, workers, memory and seconds of each part by name, and seconds in all.
    One plan is printed, the fastest whose machines still help; with --all, or where --blocks and
    --machines name several, every one of them.

    Args:
        scene: Name of a registered scene, or a scene folder. None: a city is planned.
        seconds: With SCENE: wall seconds that everything may take. None: 60.
        megabytes: With SCENE: most megabytes of the saved model. None: no bound.
        db: With SCENE: PSNR in dB at which training ends before its seconds are over, on every sixth training
            photo, 12 at most, which are kept back for that. None: the seconds are used.
        protocol: With SCENE: name or file of the rules by which it is opened. None: default.
        points: With SCENE: where the sparse points come from that training starts from: the scene's own, or
            triangulated from the training photos under their given poses. None: as the protocol says.
        strict: With SCENE: refuse a COLMAP model or transforms.json that names photos which are not there,
            instead of leaving them out.
        threads: With SCENE: threads of torch and the kernels. None: as many as torch takes by itself.
        views: Number of training views.
        gaussians: Number of Gaussians in the finished model.
        width: Width of a view in pixels. None: as the protocol says; of a city 1600.
        height: Height of a view in pixels. None: 1200.
        iterations: Training steps of each block.
        refinement: Training steps over the merged model; 0: it is not refined.
        margin: Share of its own size by which a block is widened while it trains.
        views_a_block: Number of blocks that train on a view, on average.
        cores: Number of cores of each machine.
        memory_gb: Memory of each machine in 2^30 bytes.
        blocks: Numbers of blocks to plan for. None given: the fewest that fit, and 2, 4 and 8 times
            as many.
        machines: Numbers of machines to plan for. None given: 1, 2, 4, 8, 16, 32 and 64.
        every: Print every plan, not the recommended one alone.
        simulate: Also draw unequal block times at random and hand the blocks out, longest first.
        spread: With --simulate: standard deviation of the logarithm of block times. None: as measured.
        seed: With --simulate: seed of the draw; with SCENE: of the short trainings. None: 0.
    """
    if scene:
        for_cities = {
            "--views": views != VIEWS, "--gaussians": gaussians != GAUSSIANS, "--height": height is not None,
            "--iterations": iterations != ITERATIONS, "--refinement": refinement != REFINEMENT,
            "--margin": margin != MARGIN, "--views-a-block": views_a_block != VIEWS_A_BLOCK,
            "--cores": cores != CORES, "--memory-gb": memory_gb != MEMORY_GB, "--blocks": bool(blocks),
            "--machines": bool(machines), "--all": every, "--spread": spread is not None, "--simulate": simulate,
        }  # fmt: skip
        for option, given in for_cities.items():
            if given:
                raise UsageError(f"{option} is for the plan of a city; leave {scene!r} or it out")
        return plan_scene(
            scene, seconds=60.0 if seconds is None else seconds, megabytes=megabytes or 0.0,
            db=db or 0.0, protocol=protocol or "default", width=width, points=points, strict=strict,
            seed=seed or 0, threads=threads,
        )  # fmt: skip
    for_scenes = {
        "--seconds": seconds, "--megabytes": megabytes, "--db": db, "--protocol": protocol, "--points": points,
        "--strict": strict or None, "--threads": threads,
    }  # fmt: skip
    for option, value in for_scenes.items():
        if value is not None:
            raise UsageError(f"{option} is for the plan of a scene; name the scene or leave it out")
    from splatproof.suites import city_plan

    if not simulate and (spread is not None or seed is not None):
        raise UsageError("--spread and --seed are for --simulate; add it or leave them out")

    city = city_plan.City(
        views=views, gaussians=gaussians, pixels=(width or WIDTH) * (height or HEIGHT), iterations=iterations,
        refinement=refinement, margin=margin, views_a_block=views_a_block, cores=cores,
        memory_gb=memory_gb,
    )  # fmt: skip
    fewest = city_plan.fewest_blocks(city)
    chosen = blocks or tuple(fewest * factor for factor in (1, 2, 4, 8))
    numbers = machines or MACHINES
    if every or blocks or machines:
        plans = [city_plan.plan(city, count, number) for count in chosen for number in numbers]
    else:
        plans = [city_plan.recommended(city, chosen, numbers)]
    if not output.wants_json():
        output.print_text(HEADING + ("   simulated (from - to)  busy" if simulate else ""))
    for found in plans:
        record = asdict(found) | {"seconds": found.seconds}
        text = _line(found)
        if simulate and found.workers:
            width_of = city_plan.SPREAD if spread is None else spread
            drawn = city_plan.simulate(found, width_of, seed or 0)
            record |= {f"simulated_{key}": value for key, value in asdict(drawn).items()}
            low, high, mean = (
                (value + found.serial_seconds) / 3600
                for value in (drawn.fastest, drawn.slowest, drawn.mean)
            )
            text += f"{mean:10.1f} ({low:.1f} - {high:.1f}) {drawn.busy:5.0%}"
        output.emit(record, text)
    told = tuple(dict.fromkeys(found.blocks for found in plans))
    if len(plans) == 1 and not (blocks or machines):
        output.log(
            f"recommended: of {len(chosen) * len(numbers)} plans the fastest whose machines still help; "
            "--all prints every one"
        )
    _notes(city, fewest, told)
    return 0


def _line(found: "Plan") -> str:
    hours = (found.block_seconds, found.blocks_seconds, found.serial_seconds, found.seconds)
    times = [f"{value / 3600:9.1f}" if math.isfinite(value) else "        –" for value in hours]
    memory = found.block_memory_mb / 1024
    return f"{found.blocks:6} {found.machines:8} {found.workers:7} {memory:9.1f}" + "".join(times)


def _notes(city: "City", fewest: int, chosen: tuple[int, ...]) -> None:
    """Where it stops scaling, in words, on stderr."""
    from splatproof.suites import city_plan

    useful = city_plan.most_useful_blocks(city)
    output.log(f"fewest blocks that fit: {fewest}; beyond {useful} blocks most work is pixels that "
               "every block renders again")  # fmt: skip
    for count in chosen:
        stop = city_plan.most_useful_machines(city, count)
        output.log(
            f"{count} blocks: beyond {stop} machines most time is what one machine does alone"
        )
    alone = city_plan.plan(city, fewest, 1).refine_memory_mb / 1024
    if alone > city.memory_gb:
        output.log(f"refining holds the whole model, about {alone:.0f} GB: more than a machine has; "
                   "use --refinement 0, a larger machine for it, or fewer Gaussians")  # fmt: skip
