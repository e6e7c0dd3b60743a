"""Requests to a page that is served on this machine."""

from dataclasses import dataclass
from http.client import HTTPConnection


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a server said."""

    status: int
    headers: dict[str, str]
    text: str


def ask(port: int, path: str, method: str = "GET", **headers: str) -> Answer:
    """One request; headers by their names with "_" for "-"."""
    line = HTTPConnection("127.0.0.1", port, timeout=30)
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    line.putrequest(method, path, skip_host="host" in named)
    for name, value in named.items():
        line.putheader(name, value)
    line.endheaders()
    got = line.getresponse()
    answer = Answer(
        status=got.status, text=got.read().decode(errors="replace"),
        headers={name.lower(): value for name, value in got.getheaders()},
    )  # fmt: skip
    line.close()
    return answer
