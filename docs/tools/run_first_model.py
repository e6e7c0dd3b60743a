"""The trial of docs/first_model.md: photos of made worlds, an empty home, five commands, a browser.

python docs/tools/run_first_model.py PHOTOS FOLDER

PHOTOS is where trial_photos.py keeps the photos; those that are missing are made first (minutes to an hour).
FOLDER is where the trial happens; commands that were run there are not run again, so a killed trial goes on.
What is cloned is this checkout's last commit. After each set of photos, record and page are written.
"""

import json
import os
import platform
import queue
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import trial_photos
from first_model_page import Record, Step, Trial, page
from make_front_picture import chromium
from playwright.sync_api import ViewportSize, sync_playwright

from splatproof.base.files import write_text
from splatproof.base.typed_toml import build

DOCS = Path(__file__).parents[1]
PICTURES = DOCS / "images" / "first_model"
RECORD, PAGE, WORDS = DOCS / "first_model.json", DOCS / "first_model.md", "first_model.txt"
SIZE: ViewportSize = {"width": 1100, "height": 700}
"""Pixels of the browser's window."""
PATIENCE = 1800
"""Seconds after which a command is given up."""


class Shell:
    """Bash in an empty home, with nothing of this checkout on its paths."""

    def __init__(self, folder: Path) -> None:
        """Make the home.

        Args:
            folder: Where everything happens.
        """
        self.folder = folder
        (folder / "home").mkdir(parents=True, exist_ok=True)
        self._done = folder / "steps.json"
        kept = {"PATH", "LANG", "SSL_CERT_FILE", "OMP_NUM_THREADS"}
        own = {key: value for key, value in os.environ.items()
               if key in kept or key.startswith("PIP_")}  # fmt: skip
        beside = Path(sys.executable).parent
        paths = [one for one in own["PATH"].split(":") if Path(one) != beside]
        self._environment = own | {"HOME": str(folder / "home"), "PATH": ":".join(paths)}

    def start(self, command: str, inside: str = "") -> subprocess.Popen[str]:
        """Start a command in a process group of its own.

        Args:
            command: As it is typed; `bench` is found as after `source .venv/bin/activate`.
            inside: Folder below the trial's.
        """
        active = Path(self.folder, inside, ".venv/bin/activate")
        before = f"source {active} && " if active.exists() else ""
        return subprocess.Popen(
            ["bash", "-c", before + command], cwd=self.folder / inside, env=self._environment, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip

    def run(self, command: str, inside: str = "") -> Step:
        """Run a command to its end.

        Args:
            command: As it is typed.
            inside: Folder below the trial's.
        Raises: RuntimeError with what it printed if it fails.
        """
        if (before := self.known(command)) is not None:
            return before
        started = time.perf_counter()
        running = self.start(command, inside)
        printed, _ = running.communicate(timeout=PATIENCE)
        if running.returncode:
            raise RuntimeError(f"{command} ended with {running.returncode}:\n{printed}")
        return self.step(command, time.perf_counter() - started, printed.splitlines())

    def known(self, command: str) -> Step | None:
        """What is kept of a command, if it was run here.

        Args:
            command: As it is typed.
        """
        kept = json.loads(self._done.read_text("utf-8")) if self._done.exists() else {}
        return build(Step, kept[command], str(self._done)) if command in kept else None

    def step(self, command: str, seconds: float, lines: list[str]) -> Step:
        """Keep what a command did; no name of a folder that only this machine has.

        Args:
            command: As it was typed.
            seconds: Wall time.
            lines: What it printed.
        """
        plain = [line.replace(str(self.folder.resolve()), "").rstrip() for line in lines]
        step = Step(
            command=command, seconds=round(seconds, 1), lines=tuple(one for one in plain if one)
        )
        kept = json.loads(self._done.read_text("utf-8")) if self._done.exists() else {}
        write_text(self._done, json.dumps(kept | {command: asdict(step)}, indent=1))
        return step


def _sharp(tab: Any) -> None:
    """Wait for the sharp picture; the page's policy lets no other way of waiting evaluate code."""
    end = time.monotonic() + PATIENCE
    while not tab.evaluate("typeof splatproof !== 'undefined' && !!splatproof.frames?.rests()"):
        if time.monotonic() > end:
            raise RuntimeError("no picture came")
        tab.wait_for_timeout(50)


def looked_at(shell: Shell, command: str, inside: str, name: str) -> tuple[Step, tuple[str, ...]]:
    """Serve a model, look at it in a browser, end it with ctrl-C.

    Args:
        shell: Where.
        command: `bench view` of one model.
        inside: Folder below the trial's.
        name: Of the trial.
    Returns: The command, timed until the first sharp picture, and the screenshots' names.
    """
    pictures = (f"{name}_model.jpg", f"{name}_photo_beside_render.jpg")
    if (before := shell.known(command)) is not None:
        return before, pictures
    started = time.perf_counter()
    running = shell.start(command, inside)
    said: queue.Queue[str] = queue.Queue()
    assert running.stdout is not None
    reader = threading.Thread(target=lambda out: [said.put(line) for line in out],
                              args=(running.stdout,), daemon=True)  # fmt: skip
    reader.start()
    lines = [said.get(timeout=PATIENCE)]
    try:
        while "http://" not in lines[-1]:
            lines.append(said.get(timeout=PATIENCE))
        address = next(word for word in lines[-1].split() if word.startswith("http://"))
        seconds = _photographed(address, pictures) - started
    finally:
        os.killpg(running.pid, signal.SIGINT)
        running.wait(60)
    reader.join(10)
    while not said.empty():
        lines.append(said.get())
    return shell.step(command, seconds, lines), pictures


def _photographed(address: str, pictures: tuple[str, str]) -> float:
    """Take two screenshots: the model, and a photo beside its render; when the first was sharp."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        tab = browser.new_page(viewport=SIZE)
        tab.goto(address)
        _sharp(tab)
        seen = time.perf_counter()
        tab.screenshot(path=PICTURES / pictures[0], type="jpeg", quality=80)
        tab.keyboard.press("n")
        tab.keyboard.press("g")
        tab.wait_for_timeout(1000)
        _sharp(tab)
        tab.wait_for_load_state("networkidle")
        tab.screenshot(path=PICTURES / pictures[1], type="jpeg", quality=80)
        browser.close()
    return seen


def trial(shell: Shell, name: str, photos: Path) -> Trial:
    """From a folder of photos to a model in the browser.

    Args:
        shell: With the project cloned and set up.
        name: Of the set.
        photos: Its folder.
    """
    home = "splatproof"
    link = shell.folder / name
    if not link.exists():
        link.symlink_to(photos.resolve())
    steps = [shell.run(f"bench ingest ../{name} {name}_scene", home)]
    fit = f"bench fit 3dgs {name}_scene --out {name}_model --width 320 --iterations 2000"
    steps.append(shell.run(fit, home))
    last, pictures = looked_at(shell, f"bench view {name}_model --port 0", home, name)
    about = f"{len(list(photos.iterdir()))} photos: {trial_photos.SETS[name].__doc__}"
    return Trial(name=name, photos=about.rstrip("."), steps=(*steps, last), pictures=pictures)


def machine() -> str:
    """What the times were measured on."""
    with Path("/proc/cpuinfo").open() as file:
        model = next((line.partition(":")[2].strip() for line in file if "model name" in line), "")
    loads = " ".join(f"{load:.1f}" for load in os.getloadavg())
    return (
        f"{os.cpu_count()} cores, {model or platform.machine()}; load averages of the last 1, 5 and 15 minutes "
        f"at the end: {loads}; priority nice {os.nice(0)}"
    )


def render(record: Record) -> None:
    """Write the page of a record."""
    write_text(PAGE, page(record, (DOCS / "words" / WORDS).read_text("utf-8")))


def read_record() -> Record:
    """The record that is committed."""
    return build(Record, json.loads(RECORD.read_text("utf-8")), str(RECORD))


def main() -> None:
    """Run all trials, write record, pictures and page."""
    photos, shell = Path(sys.argv[1]), Shell(Path(sys.argv[2]))
    for name in trial_photos.SETS:
        trial_photos.make(name, photos / name)
    clone = shell.run(f"git clone -q {DOCS.parent.resolve()} splatproof")
    make = shell.run("make setup", "splatproof")
    setup = (
        replace(clone, command="git clone REPOSITORY splatproof && cd splatproof"),
        replace(make, command=f"{make.command} && source .venv/bin/activate"),
    )
    trials: list[Trial] = []
    for name in trial_photos.SETS:
        trials.append(trial(shell, name, photos / name))
        record = Record(machine=machine(), setup=setup, trials=tuple(trials))
        write_text(RECORD, json.dumps(asdict(record), indent=1, ensure_ascii=False) + "\n")
        render(record)


if __name__ == "__main__":
    main()
