"""`bench dashboard`: one page over a whole store, served here or written as plain files."""

import webbrowser
from pathlib import Path
from typing import Annotated

import tyro

from splatproof.base.errors import UsageError
from splatproof.cli import output


def dashboard(
    *,
    out: Path = Path("runs"),
    uri: str | None = None,
    static: Path | None = None,
    picture_mb: float = 200.0,
    port: int = 8765,
    open: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    cache: Path | None = None,
) -> None:
    """Show leaderboards, histories, comparisons, claims, plots and pictures of a whole store.

    Serves one page at http://127.0.0.1:PORT/, for this machine alone, until ctrl-C; it reads nothing but
    the tracking store, and new runs appear when the page is loaded again. With --static it writes the
    same page as files that open without a server. With --json the address, or the folder with its
    files, bytes and what was left out, is one JSON object.

    Args:
        out: Folder of runs whose store is shown: what `bench run` or `bench report` calls OUT.
        uri: Tracking URI of the store. None: MLFLOW_TRACKING_URI, else OUT/mlflow.db.
        static: Folder to write the page to in place of serving it: new, empty or of an earlier build.
        picture_mb: Megabytes of pictures in a static page, as JPEG; the page says what was left out.
        port: Port that is served; 0: any that is free.
        open: Also open the page in the browser.
        cache: File that keeps what was read of the store. None: beside an SQLite store, else
            OUT/dashboard.cache.
    """
    from splatproof.base.local_server import listening
    from splatproof.reports.dashboard.cache import Cache
    from splatproof.reports.dashboard.server import serve
    from splatproof.reports.dashboard.site import Site
    from splatproof.reports.dashboard.static_site import build_site
    from splatproof.reports.mlflow_client import check_uri, default_uri, shown_uri, sqlite_file

    if picture_mb < 0:
        raise UsageError(f"--picture-mb {picture_mb:g}: expected 0 or more")
    uri = default_uri(out) if uri is None else uri
    check_uri(uri)
    file = sqlite_file(uri)
    if file is not None and not file.exists():
        raise UsageError(
            f"nothing to show: {shown_uri(uri)} does not exist; run `bench run quick` first, log "
            "records with `bench report`, or name the folder with --out"
        )
    socket = None if static else listening(port)
    kept = cache or (out / "dashboard.cache" if file is None else file.with_suffix(".dashboard"))
    kept.parent.mkdir(parents=True, exist_ok=True)
    with output.progress() as bar:
        tasks = {}

        def progress(doing: str, done: int, total: int) -> None:
            if doing not in tasks:
                tasks[doing] = bar.add_task(doing, total=total, values="")
            bar.update(tasks[doing], completed=done, total=total)

        site = Site(uri, Cache(kept), _claims(), progress)
        built = build_site(site, static, picture_mb, progress) if static else None
    if static and built:
        page = (static / "index.html").resolve()
        record = {"page": str(page), "files": built.files, "bytes": built.bytes}
        output.emit(record | {"left_out": built.left_out},
                    f"page: {page} ({built.files} files, {built.bytes / 2**20:.1f} MB)")  # fmt: skip
        if built.left_out:
            output.log(built.left_out)
        if open:
            webbrowser.open(page.as_uri())
    if socket:
        address = f"http://127.0.0.1:{socket.getsockname()[1]}/"
        output.emit({"address": address}, f"{address}  (ctrl-C ends it)")
        if open:
            webbrowser.open(address)
        try:
            serve(site, socket)
        except KeyboardInterrupt:
            output.log("ended")


def _claims():
    """All claims, with the published numbers that they are about."""
    from splatproof.reports.claims.claim import all_claims
    from splatproof.suites.published.rows import numbers

    return all_claims(numbers())[0]
