"""Unpacks archives from strangers: nothing outside the folder, no links, no bombs, all or nothing."""

import errno
import gzip
import lzma
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO

from splatproof.base.errors import DataError, UsageError
from splatproof.base.files import CHUNK
from splatproof.base.folders import working_folder

LIMIT = 512 * 2**30
"""Default bound on the unpacked bytes of one archive."""
DAMAGED = (
    tarfile.TarError, zipfile.BadZipFile, gzip.BadGzipFile, zlib.error, lzma.LZMAError, EOFError,
    NotImplementedError,  # zipfile's word for a compression that it does not know
    struct.error, ValueError, IndexError, MemoryError,  # fields of headers that lie
)  # fmt: skip
"""What the readers say of archives that are cut short, garbled or of an unknown compression."""
OF_THE_ARCHIVE = (errno.ENAMETOOLONG, errno.EINVAL)
"""What the system says to a member's name, or to a place before the archive's start."""
MEMBERS = 2_000_000
"""Bound on the number of members."""


def extract(archive: Path, folder: Path, *, limit: int = LIMIT) -> Path:
    """Unpack a zip or tar archive as `folder`, which must not exist yet.

    It is unpacked beside `folder` and takes its name when all went well. An archive whose
    members all lie in one folder loses that folder.

    Args:
        archive: .zip, .tar, .tar.gz, .tgz, .tar.bz2 or .tar.xz, told by content.
        folder: New.
        limit: Bytes that may come out.

    Raises:
        UsageError: `folder` exists.
        DataError: not an archive, damaged, too large, or a member that is absolute, climbs out,
            or is neither file nor folder.
    """
    if folder.exists():
        raise UsageError(f"{folder}: exists already; remove it first")
    with working_folder(folder) as work:
        _unpack(archive, work, limit)
        inside = list(work.iterdir())
        whole = inside[0] if len(inside) == 1 and inside[0].is_dir() else work
        whole.rename(folder)
    return folder


def _unpack(archive: Path, work: Path, limit: int) -> None:
    left = limit
    try:
        members = _members(archive)
        for count, (name, content) in enumerate(members):
            target = work / _safe(archive, name)
            if count >= MEMBERS:
                raise DataError(f"{archive}: more than {MEMBERS} members; not unpacked")
            if content is None:
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.exists():
                raise DataError(f"{archive}: member {name!r} occurs twice; not unpacked")
            with target.open("xb") as file:
                while chunk := content.read(CHUNK):
                    left -= len(chunk)
                    if left < 0:
                        raise DataError(
                            f"{archive}: unpacks to more than {limit} bytes; not unpacked"
                        )
                    file.write(chunk)
    except DAMAGED as error:
        raise DataError(f"{archive}: damaged archive ({error}); download it again") from None
    except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
        raise DataError(
            f"{archive}: a member is file and folder at once ({error.filename})"
        ) from None
    except OSError as error:
        if error.errno not in OF_THE_ARCHIVE:
            raise
        raise DataError(
            f"{archive}: a member cannot be unpacked ({error.strerror}); its name or place is damaged"
        ) from None
    except RuntimeError as error:  # zipfile's way of saying that a password is wanted
        raise DataError(f"{archive}: cannot be read ({error})") from None


def _members(archive: Path) -> Iterator[tuple[str, IO[bytes] | None]]:
    """Name and content (None: a folder) of each member; only files and folders may be in it."""
    if zipfile.is_zipfile(archive):
        with zipfile.ZipFile(archive) as packed:
            for info in packed.infolist():
                mode = stat.S_IFMT(info.external_attr >> 16)
                if mode not in (0, stat.S_IFREG, stat.S_IFDIR):
                    raise DataError(f"{archive}: member {info.filename!r} is a link or device")
                if info.is_dir():
                    yield info.filename, None
                    continue
                with packed.open(info) as content:
                    yield info.filename, content
        return
    try:
        packed = tarfile.open(archive)  # noqa: SIM115 (closed below; opening has its own error)
    except (*DAMAGED, OSError):
        raise DataError(f"{archive}: neither a zip nor a tar archive, or cut short") from None
    with packed:
        for info in packed:
            if not (info.isfile() or info.isdir()):
                raise DataError(f"{archive}: member {info.name!r} is a link or device")
            yield info.name, packed.extractfile(info) if info.isfile() else None


def _safe(archive: Path, name: str) -> Path:
    """A member's path below the folder. Raises: DataError if it would lie elsewhere."""
    path = PurePosixPath(name.replace("\\", "/"))
    drive = len(name) > 1 and name[1] == ":"
    if path.is_absolute() or drive or ".." in path.parts or "\0" in name:
        raise DataError(f"{archive}: member {name!r} would leave the folder; not unpacked")
    return Path(*path.parts)
