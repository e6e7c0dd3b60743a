"""Train the depth network of `--depth-prior network:PATH` on worlds made for it.

    python docs/tools/train_depth_network.py OUT.safetensors --worlds street tunnel --seeds 8

The seeds begin at FIRST_SEED, where no registered scene lies, so that no tested world is trained on;
leave out a whole kind of world (--worlds) to see what the network says of one that it never saw.
The file's facts name the worlds, seeds and steps. About half a second a step on one thread.
"""

import argparse
import tempfile
from pathlib import Path

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.procedural.worlds import WORLDS, make
from splatproof.datasets.progress import bar
from splatproof.methods.priors.network import save_network
from splatproof.methods.priors.network_training import samples_of, train
from splatproof.metrics.protocol_files import load_protocol

FIRST_SEED = 1000


def main(arguments: list[str] | None = None) -> None:
    """Make the worlds, train, write the weights."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--worlds", nargs="+", choices=sorted(WORLDS), default=["street", "tunnel"])
    parser.add_argument("--preset", default="small")
    parser.add_argument("--seeds", type=int, default=4, help="worlds of each kind")
    parser.add_argument("--steps", type=int, default=2000)
    given = parser.parse_args(arguments)
    seeds = list(range(FIRST_SEED, FIRST_SEED + given.seeds))
    samples = []
    with tempfile.TemporaryDirectory() as folder:
        for world in given.worlds:
            for seed in seeds:
                with bar(f"making {world} {seed}") as report:
                    made = make(world, given.preset, seed, Path(folder, f"{world}{seed}"), report)
                samples += samples_of(open_scene(made, load_protocol("default")))
    with bar(f"training on {len(samples)} views") as report:
        network = train(
            samples, steps=given.steps, report=lambda step, steps, loss: report(step, steps)
        )
    facts = {"worlds": given.worlds, "preset": given.preset, "seeds": seeds, "steps": given.steps}
    save_network(given.out, network, facts)


if __name__ == "__main__":
    main()
