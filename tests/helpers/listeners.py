"""What a process and those below it listen on (Linux)."""

import ipaddress
import os
from collections.abc import Iterator
from pathlib import Path

LISTENS = {"tcp": "0A", "tcp6": "0A", "udp": "07", "udp6": "07"}
"""Tables of /proc/net and their number for a socket that takes what anybody sends."""


def listeners(process: int) -> dict[str, str]:
    """Addresses at which a process and its descendants take connections or datagrams.

    Args:
        process: Its number.
    Returns: "protocol address:port" to the name of a process that holds it; sockets of files, which
        have no address, are left out.
    """
    held = {inode: pid for pid in [process, *below(process)] for inode in _sockets(pid)}
    found = {}
    for table, state in LISTENS.items():
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == state and words[9] in held:
                found[f"{table} {_address(words[1])}"] = _called(held[words[9]])
    return found


def reachable(process: int) -> dict[str, str]:
    """Those of its `listeners` that another machine could reach.

    Args:
        process: Its number.
    """
    return {at: who for at, who in listeners(process).items() if not _is_loopback(at)}


def _is_loopback(at: str) -> bool:
    address = ipaddress.ip_address(at.split(" ")[1].rpartition(":")[0])
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback


def below(process: int) -> list[int]:
    """Descendants of a process.

    Args:
        process: Its number.
    """
    parents = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(entry.name)] = int(
                (entry / "stat").read_text().rpartition(")")[2].split()[1]
            )
        except OSError:  # it has ended
            continue
    found, new = [], [process]
    while new:
        new = [pid for pid, parent in parents.items() if parent in new]
        found += new
    return found


def _sockets(process: int) -> Iterator[str]:
    """Inodes of its sockets."""
    try:
        for link in Path(f"/proc/{process}/fd").iterdir():
            target = os.readlink(link)
            if target.startswith("socket:["):
                yield target[8:-1]
    except OSError:
        return


def _address(text: str) -> str:
    """The address:port of a line of /proc/net: words of 32 bits, each in the machine's order."""
    host, port = text.split(":")
    words = [bytes.fromhex(host[i : i + 8])[::-1] for i in range(0, len(host), 8)]
    return f"{ipaddress.ip_address(b''.join(words))}:{int(port, 16)}"


def _called(process: int) -> str:
    return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode()[:200]
