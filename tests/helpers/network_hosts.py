"""Hosts of a network on one machine: network namespaces joined by a bridge, each with an address of its own."""

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count as counting
from pathlib import Path

NETWORKS = counting()
"""Names are used once: what a namespace held goes away a moment after it."""
SUBNET = "10.213.77"
"""First three numbers of the hosts' addresses, within the machine alone."""


def unavailable() -> str:
    """Why no such hosts can be made here; "" where they can."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        return "network namespaces need root and the command ip (package iproute2)"
    probe = f"sp{os.getpid()}x"
    if subprocess.run(["ip", "netns", "add", probe], check=False, capture_output=True).returncode:
        return "this machine lets nobody make network namespaces"
    _ip("netns", "del", probe)
    return ""


@dataclass(frozen=True)
class Host:
    """One of them."""

    number: int
    """From 1: the last number of its address."""
    name: str
    """Of its namespace."""
    cable: str
    """The bridge's end of its cable."""
    begun: list[subprocess.Popen[bytes]] = field(default_factory=list)
    """What was started there."""

    @property
    def address(self) -> str:
        """Its IPv4 address."""
        return f"{SUBNET}.{self.number}"

    def start(
        self, command: Sequence[str], log: Path, env: Mapping[str, str]
    ) -> subprocess.Popen[bytes]:
        """Start a command there.

        Args:
            command: Program and arguments.
            log: File that its output is added to.
            env: Variables beside those of this process; of these, no proxy, which nothing reaches from there.
        """
        own = {
            key: value for key, value in os.environ.items() if not key.lower().endswith("_proxy")
        }
        with log.open("ab") as out:
            process = subprocess.Popen(
                ["ip", "netns", "exec", self.name, *command],
                stdout=out, stderr=subprocess.STDOUT, env={**own, **env}, start_new_session=True,
            )  # fmt: skip
        self.begun.append(process)
        return process

    def processes(self) -> list[int]:
        """Whatever runs there."""
        told = subprocess.run(
            ["ip", "netns", "pids", self.name], check=False, capture_output=True, text=True
        )
        return [int(pid) for pid in told.stdout.split()]

    def cut(self) -> None:
        """Pull its cable: it goes on, and nobody hears of it."""
        _ip("link", "set", self.cable, "down")

    def end(self) -> None:
        """End all that runs there at once, as a power cut does."""
        for pid in self.processes():
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue


@contextmanager
def hosts(count: int) -> Iterator[list[Host]]:
    """Make so many hosts that reach each other and nothing else; afterwards all that runs there is ended.

    Args:
        count: How many, 1 to 200.
    """
    mark = f"sp{os.getpid() % 100_000}x{next(NETWORKS)}"
    made = [Host(n, f"{mark}n{n}", f"{mark}v{n}") for n in range(1, count + 1)]
    bridge = f"{mark}br"
    try:
        _ip("link", "add", bridge, "type", "bridge")
        _ip("link", "set", bridge, "up")
        for host in made:
            _ip("netns", "add", host.name)
            far = ("peer", "name", "eth0", "netns", host.name)
            _ip("link", "add", host.cable, "type", "veth", *far)
            _ip("link", "set", host.cable, "master", bridge, "up")
            _ip("-n", host.name, "address", "add", f"{host.address}/24", "dev", "eth0")
            for device in ("lo", "eth0"):
                _ip("-n", host.name, "link", "set", device, "up")
            # programs ask the way to the outer world what their own address is
            _ip("-n", host.name, "route", "add", "default", "dev", "eth0")
        yield made
    finally:
        for host in made:
            host.end()
            for process in host.begun:
                process.wait()
            subprocess.run(["ip", "netns", "del", host.name], check=False, capture_output=True)
        subprocess.run(["ip", "link", "del", bridge], check=False, capture_output=True)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)
