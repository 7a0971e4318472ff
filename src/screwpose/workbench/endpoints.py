"""What the pages fetch besides themselves: pixels, meshes, previews, and the files of an export."""

import contextlib
import os
import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

from fastapi import FastAPI, HTTPException
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from starlette.background import BackgroundTask

from screwpose.errors import CaseError
from screwpose.workbench.sessions import Sessions
from screwpose.workbench.store import REPORT_FOLDER, RESULT_FOLDER

_KEY = re.compile(r"[0-9a-f]{32}")
# By the name in the address; nothing else can be asked for.
_EXPORTS = {
    "result.json": (f"{RESULT_FOLDER}/result.json", "application/json"),
    "report.html": (f"{REPORT_FOLDER}/report.html", "text/html; charset=utf-8"),
    "combinations.csv": (f"{REPORT_FOLDER}/combinations.csv", "text/csv"),
    "meshes.zip": (f"{REPORT_FOLDER}/meshes.zip", "application/zip"),
    "case.json": ("case.json", "application/json"),
}
_KINDS = {"pixels": ("u16", "application/octet-stream"), "mesh": ("stl", "model/stl"), "preview": ("png", "image/png")}
# An export's page was made from labels that a person typed: it runs no script outside of itself, and sees no cookie.
_SANDBOX = {"content-security-policy": "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:"}
# They never change, and are compressed as far as they can be: the pixels' noise cannot.
_FOR_GOOD = {"cache-control": "private, max-age=86400, immutable", "content-encoding": "identity"}


def add_endpoints(app: FastAPI, sessions: Sessions, static: Path) -> None:
    """Add them to the application."""
    app.mount("/static", StaticFiles(directory=static))

    @app.get("/pixels/{key}")
    def pixels(key: str) -> FileResponse:
        return cached("pixels", key)

    @app.get("/mesh/{key}")
    def mesh(key: str) -> FileResponse:
        return cached("mesh", key)

    @app.get("/preview/{key}")
    def preview(key: str) -> FileResponse:
        return cached("preview", key)

    def cached(kind: str, key: str) -> FileResponse:
        suffix, media = _KINDS[kind]
        path = sessions.cache / f"{key}.{suffix}"
        if not _KEY.fullmatch(key):
            raise HTTPException(404)
        if not path.is_file():
            raise HTTPException(404)
        return FileResponse(path, media_type=media, headers=_FOR_GOOD)

    @app.get("/export/{case}/{name}")
    def exported(case: str, name: str) -> FileResponse:
        folder = _folder(sessions, case)
        if name == "case.zip":
            return _zipped(folder)
        if name not in _EXPORTS or not (folder / _EXPORTS[name][0]).is_file():
            raise HTTPException(404)
        place, media = _EXPORTS[name]
        return FileResponse(
            folder / place, media_type=media, filename=f"{case}-{name}", headers=_SANDBOX,
            content_disposition_type="inline" if name == "report.html" else "attachment",
        )  # fmt: skip


def _folder(sessions: Sessions, case: str) -> Path:
    try:
        return sessions.workspace.folder_of(case)
    except CaseError as error:
        raise HTTPException(404) from error


def _shown_files(folder: Path) -> Iterator[Path]:
    """The files of a case. What is hidden is nothing to another computer: whose the case is here, what is written now,
    or was when a solve was killed."""
    for above, folders, names in os.walk(folder):
        folders[:] = sorted(one for one in folders if not one.startswith("."))
        paths = (Path(above, name) for name in sorted(names) if not name.startswith("."))
        yield from (path for path in paths if path.is_file())


def _zipped(folder: Path) -> FileResponse:
    """The whole case folder, to be opened on another computer."""
    place = Path(tempfile.mkdtemp(prefix="screwpose-zip-"))
    archive = place / f"{folder.name}.zip"
    try:
        # Zip knows no time before 1980, which files from archives may have.
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as packed:
            for path in _shown_files(folder):
                with contextlib.suppress(FileNotFoundError):  # a solve that ends now puts another in its place
                    packed.write(path, path.relative_to(folder.parent))
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
    return FileResponse(
        archive, media_type="application/zip", filename=f"{folder.name}.zip",
        background=BackgroundTask(shutil.rmtree, place, ignore_errors=True),
    )  # fmt: skip
