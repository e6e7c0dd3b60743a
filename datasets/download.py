"""Downloads that can be stopped at any moment: resumed, checked, and whole or not there at all."""

import errno
import http.client
import os
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from splatproof.base import files
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.base.folders import check_disk

TIMEOUT = 30.0
"""Seconds without an answer after which a connection counts as broken."""
ATTEMPTS = 4
"""Connections tried one after the other while none brings a byte."""
WAIT = 1.0
"""Seconds before the second attempt; doubled each time."""
OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EFBIG)
"""Errors that trying again does not cure."""
SCHEMES = ("http", "https")
"""Kinds of addresses that are fetched from, also after a redirect."""
Report = Callable[[int, int], None]
"""Told (bytes so far, bytes in all or 0 where the server does not say)."""


class _WebAlone(urllib.request.HTTPRedirectHandler):
    """Follows redirects to http and https; urllib's own follows them to ftp too."""

    def redirect_request(
        self,
        req: urllib.request.Request,
        fp: Any,
        code: int,
        msg: str,
        headers: http.client.HTTPMessage,
        newurl: str,
    ) -> urllib.request.Request | None:
        """The next request. Raises: MissingError for an address that is not the web's."""
        if urllib.parse.urlsplit(newurl).scheme not in SCHEMES:
            fp.close()
            raise MissingError(
                f"{req.full_url}: leads to {newurl}, which is not followed; expected http or https"
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)


_OPENER = urllib.request.build_opener(_WebAlone)


def download(
    url: str,
    target: Path,
    *,
    sha256: str,
    report: Report = lambda done, total: None,
    timeout: float = TIMEOUT,
    wait: float = WAIT,
) -> Path:
    """Fetch a file to `target` and check it.

    Bytes go to `<target>.part` beside it, from which a later call continues; the file takes its
    name after its checksum is right.

    Args:
        url: http or https.
        target: A file that is there with this checksum already is left alone.
        sha256: Checksum that the whole file must have, in hex.
        report: Told the progress.
        timeout: Seconds without an answer after which a connection counts as broken.
        wait: Seconds before a broken connection is tried again.

    Raises:
        UsageError: not a web address.
        MissingError: the server says no, does not answer, or the disk is full.
        DataError: the file came whole and has another checksum; it is deleted.
    """
    if urllib.parse.urlsplit(url).scheme not in SCHEMES:
        raise UsageError(f"{url}: expected an address with http:// or https://")
    if target.is_file() and files.sha256(target) == sha256.lower():
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(target.name + ".part")
    failures = 0
    while True:
        before = part.stat().st_size if part.exists() else 0
        try:
            _fetch(url, part, report, timeout)
            break
        except urllib.error.HTTPError as error:
            error.close()
            if error.code < 500 and error.code not in (408, 429):
                raise MissingError(
                    f"{url}: the server answers {error.code} {error.reason}"
                ) from None
            reason = f"{error.code} {error.reason}"
        except (OSError, http.client.HTTPException) as error:
            if isinstance(error, OSError) and error.errno in OF_THE_DISK:
                raise MissingError(f"{part}: cannot write ({error.strerror})") from None
            reason = str(getattr(error, "reason", "") or error or type(error).__name__)
        grown = part.exists() and part.stat().st_size > before
        failures = 1 if grown else failures + 1
        if failures >= ATTEMPTS:
            raise MissingError(
                f"{url}: no connection brought a byte in {ATTEMPTS} attempts ({reason}); "
                "the same command continues where this one stopped"
            ) from None
        time.sleep(wait * 2 ** (failures - 1))
    found = files.sha256(part)
    if found != sha256.lower():
        part.unlink()
        raise DataError(
            f"{url}: sha256 is {found}, expected {sha256}; the file was deleted, try again or "
            "correct the registry"
        )
    os.replace(part, target)
    return target


def _fetch(url: str, part: Path, report: Report, timeout: float) -> None:
    """One connection: append what is missing to the partial file, or begin again."""
    have = part.stat().st_size if part.exists() else 0
    headers = {"User-Agent": "splatproof", "Accept-Encoding": "identity"}
    if have:
        headers["Range"] = f"bytes={have}-"
    request = urllib.request.Request(url, headers=headers)
    try:
        answer = _OPENER.open(request, timeout=timeout)
    except urllib.error.HTTPError as error:
        if error.code != 416 or not have:
            raise
        # nothing lies beyond what we have: whole already, or not a part of this file at all
        if error.headers.get("Content-Range") == f"bytes */{have}":
            return
        part.unlink()
        return _fetch(url, part, report, timeout)
    with answer:
        resumed = answer.status == 206 and _range_start(answer) == have
        if answer.status == 206 and not resumed:
            part.unlink()
            raise http.client.HTTPException("the server sent another range than was asked for")
        have = have if resumed else 0
        length = answer.headers.get("Content-Length")
        total = have + int(length) if length is not None else 0
        check_disk(part.parent, total - have, "make room or choose another data root")
        with part.open("ab" if resumed else "wb") as file:
            while chunk := answer.read(files.CHUNK):
                file.write(chunk)
                have += len(chunk)
                report(have, total)
    if have < total:
        raise http.client.IncompleteRead(b"", total - have)


def _range_start(answer: http.client.HTTPResponse) -> int:
    """First byte of a partial answer, -1 where the header makes no sense."""
    words = (answer.headers.get("Content-Range") or "").split()
    first = words[1].split("-")[0] if len(words) == 2 else ""
    return int(first) if first.isdigit() else -1
