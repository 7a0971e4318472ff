"""Files from the browser onto the disk, under names that are ours."""

import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from nicegui import events, ui

from screwpose.workbench.guard import LARGEST_UPLOAD_BYTES
from screwpose.workbench.sessions import Sessions
from screwpose.workbench.store import safe_file_name

MOST_FILES = 24


@dataclass(frozen=True)
class Uploaded:
    """A file that came in: where it is, and what its owner calls it."""

    path: Path
    name: str


def uploader(sessions: Sessions, take: Callable[[list[Uploaded]], Awaitable[None]], label: str) -> ui.upload:
    """A place to drop files on; `take` gets those that came in together, and they are gone when it is done."""

    async def arrived(event: events.MultiUploadEventArguments) -> None:
        files = []
        try:
            for file in event.files[:MOST_FILES]:
                # Readers of meshes go by the suffix; the rest of a name never reaches the disk here.
                suffix = Path(safe_file_name(str(file.name))).suffix.lower()[:8]
                place = sessions.uploads / f"{secrets.token_hex(16)}{suffix}"
                files.append(Uploaded(place, str(file.name)[:200]))
                await file.save(place)
            await take(files)
        finally:
            for one in files:
                one.path.unlink(missing_ok=True)
            upload.reset()

    def rejected() -> None:
        ui.notify(
            f"Not taken: at most {MOST_FILES} files, {LARGEST_UPLOAD_BYTES // 2**20} MB together.", type="negative"
        )

    upload = ui.upload(
        multiple=True, auto_upload=True, label=label, max_files=MOST_FILES, max_total_size=LARGEST_UPLOAD_BYTES,
        on_multi_upload=arrived, on_rejected=rejected,
    )  # fmt: skip
    return upload.props("flat bordered").classes("drop")
