"""Meshes that are dear to make, kept by the content of what they were made of: in memory, and on disk between runs.

The folder is ``$SCREWPOSE_CACHE``, else ``screwpose`` in the user's cache folder; ``SCREWPOSE_CACHE=off`` writes and
reads nothing. A file that is damaged, or of another version, is made again; one that cannot be written is not.
"""

import hashlib
import os
import sys
import tempfile
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from threading import Lock

import numpy as np

from screwpose.implants.model import Mesh

VARIABLE = "SCREWPOSE_CACHE"
_VERSION = 1  # rises when a mesh would be made differently
_IN_MEMORY = 32
_ON_DISK = 400  # files; some 0.1 to 2 MB each
_SUFFIX = ".npz"

_memory: OrderedDict[str, Mesh] = OrderedDict()
_lock = Lock()


def cache_folder() -> Path | None:
    """Where meshes are kept between runs; None where that is switched off, or there is no home."""
    chosen = os.environ.get(VARIABLE)
    if chosen is not None:
        return None if chosen.strip().lower() in ("", "0", "off", "no") else Path(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA")
    elif sys.platform == "darwin":
        base = str(Path("~/Library/Caches"))
    else:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache"))
    try:
        folder = Path(base).expanduser() if base else None
    except RuntimeError:  # no home
        return None
    return folder / "screwpose" if folder is not None and folder.is_absolute() else None


def kept(name: str, mesh: Mesh, make: Callable[[], Mesh]) -> Mesh:
    """A mesh that was made of another, or is made now.

    Parameters
    ----------
    name : what is made, with all that it depends on besides the mesh.
    mesh : what it is made of; what it is called or where it came from does not count.
    make : a pure function of both.
    """
    key = _key(name, mesh)
    with _lock:
        known = _memory.get(key)
        if known is not None:
            _memory.move_to_end(key)
            return known
    folder = cache_folder()
    found = None if folder is None else _read(folder / (key + _SUFFIX))
    if found is None:
        found = make()
        if folder is not None:
            _write(folder / (key + _SUFFIX), found)
    with _lock:
        _memory[key] = found
        while len(_memory) > _IN_MEMORY:
            _memory.popitem(last=False)
    return found


def forget() -> None:
    """Empty the memory; what is on disk stays."""
    with _lock:
        _memory.clear()


def _key(name: str, mesh: Mesh) -> str:
    digest = hashlib.blake2b(f"{_VERSION} {name} {mesh.vertices_mm.shape} {mesh.faces.shape}".encode(), digest_size=20)
    digest.update(np.ascontiguousarray(mesh.vertices_mm, dtype="<f8").data)
    digest.update(np.ascontiguousarray(mesh.faces, dtype="<i8").data)
    return digest.hexdigest()


def _read(path: Path) -> Mesh | None:
    try:
        # NumPy leaves a damaged file open that it opened itself.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            vertices, faces = stored["vertices_mm"], stored["faces"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    is_mesh = vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3 and len(faces) > 0
    if not is_mesh or vertices.dtype != np.float64 or faces.dtype != np.int64:
        return None
    if not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        return None
    return Mesh(vertices, faces)


def _write(path: Path, mesh: Mesh) -> None:
    """Write in one step, so that another process reads all of it or none; or leave it, where that is not allowed."""
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            temporary = Path(file.name)
            np.savez(
                file,
                vertices_mm=np.asarray(mesh.vertices_mm, dtype=np.float64),
                faces=np.asarray(mesh.faces, dtype=np.int64),
            )
        os.replace(temporary, path)  # noqa: PTH105  (the one call that is atomic on every platform)
        _remove_the_oldest(path.parent)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _remove_the_oldest(folder: Path) -> None:
    with os.scandir(folder) as entries:
        files = [entry for entry in entries if entry.name.endswith(_SUFFIX)]
    if len(files) > _ON_DISK:
        for entry in sorted(files, key=lambda entry: entry.stat().st_mtime)[: len(files) - _ON_DISK * 3 // 4]:
            Path(entry.path).unlink(missing_ok=True)
