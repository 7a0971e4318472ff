"""Writing so that a reader, or a crash, never meets half a file or half a folder.

A file is written beside its place, forced to the disk and renamed over it. A folder is filled under another name and
takes its place when it is complete; what stood there before stays until then.
"""

import contextlib
import errno
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from screwpose.errors import OutputError

_LINE = 120


def write_bytes(path: str | Path, data: bytes) -> Path:
    """Write a file at once: afterwards it is there in full, or, on an error, as it was before.

    Returns
    -------
    The path.

    Raises
    ------
    OutputError
        It cannot be written; the message names the path and the remedy.
    """
    path = Path(path)
    # A link is followed, so that writing through it changes what it points to, as with any other program.
    place = path.resolve()
    partial = place.with_name(f".{place.name[:100]}.{secrets.token_hex(4)}.partial")
    try:
        try:
            with partial.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(place)
        finally:
            partial.unlink(missing_ok=True)
        _sync_folder(place.parent)
    except OSError as error:
        raise _output_error(path, error) from error
    return path


def write_text(path: str | Path, text: str) -> Path:
    """Write a text file at once, in UTF-8 with plain line ends; see `write_bytes`."""
    return write_bytes(path, text.encode())


def write_json(path: str | Path, content: BaseModel | Any) -> Path:
    """Write JSON at once; see `write_bytes`.

    A model is written without the keys that are None: what was not estimated is absent.

    Raises
    ------
    OutputError
        It cannot be written, or a number in it is not finite.
    """
    data = content.model_dump(mode="json", exclude_none=True) if isinstance(content, BaseModel) else content
    try:
        text = json_text(data)
    except ValueError as error:
        raise OutputError(f"{path}: {error}: JSON has no such number. This is an error of the program.") from error
    return write_text(path, text + "\n")


def json_text(data: Any, indent: str = "") -> str:
    """JSON that people can read: what fits into a line stays in one, so that a matrix takes four lines, not twenty.

    Raises
    ------
    ValueError
        A number is not finite.
    """
    line = json.dumps(data, ensure_ascii=False, allow_nan=False)
    deeper = indent + "  "
    if not isinstance(data, dict | list | tuple) or not data or (len(indent) + len(line) <= _LINE and indent):
        return line
    if isinstance(data, dict):
        keys = (json.dumps(str(key), ensure_ascii=False) for key in data)
        items = [f"{key}: {json_text(value, deeper)}" for key, value in zip(keys, data.values(), strict=True)]
        opening, closing = "{", "}"
    else:
        items = [json_text(value, deeper) for value in data]
        opening, closing = "[", "]"
    return f"{opening}\n{deeper}" + f",\n{deeper}".join(items) + f"\n{indent}{closing}"


@contextlib.contextmanager
def atomic_folder(path: str | Path, marker: str = "result.json") -> Iterator[Path]:
    """Fill a folder that takes its place only when it is complete.

    Parameters
    ----------
    path : where the folder is to stand. What is there already is replaced only if it is an empty folder or an earlier
        output, known by its `marker`; it stays as it is until the new one is complete.
    marker : the name of a file that every complete output holds, and that a folder of another kind would not.

    Yields
    ------
    The folder to write into, a sibling of `path` under another name. On an exception, Ctrl-C among them, it is removed.

    Raises
    ------
    OutputError
        The folder cannot be written, or something else stands in its place.
    """
    place = _replaceable(Path(path), marker)
    partial = _sibling(place, "partial")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        partial.mkdir()
    except OSError as error:
        raise _output_error(path, error) from error
    try:
        yield partial
        if not (partial / marker).is_file():
            raise OutputError(f"{path}: the output is not complete, {marker} was not written. The folder is not kept.")
        _take_place(partial, _replaceable(Path(path), marker))
    except OSError as error:
        if error.filename is None or _within(error.filename, partial):
            raise _output_error(path, error) from error
        raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def ensure_can_write_folder(path: str | Path, marker: str = "result.json") -> None:
    """Find out before long work whether `atomic_folder` will be able to write its folder. Nothing is left behind.

    Raises
    ------
    OutputError
        It will not: something else stands there, or the folder above cannot be written.
    """
    place = _replaceable(Path(path), marker)
    above = next(folder for folder in place.parents if folder.exists())
    # Trying is the only test that knows of read-only disks, quotas and access lists.
    trial = above / f".{secrets.token_hex(8)}.trial"
    try:
        trial.mkdir()
        trial.rmdir()
    except OSError as error:
        raise _output_error(path, error) from error


def _replaceable(path: Path, marker: str) -> Path:
    """The real place of `path`, if a folder of ours may stand there."""
    try:
        place = path.resolve()
        if not place.exists():
            above = next(folder for folder in place.parents if folder.exists())
            if not above.is_dir():
                raise OutputError(f"{path}: {above} is a file, not a folder. Choose another folder.")
            return place
        if not place.is_dir():
            raise OutputError(f"{path}: a file stands where the output folder is to be. Choose another folder.")
        if any(place.iterdir()) and not (place / marker).is_file():
            raise OutputError(
                f"{path}: the folder is not empty and holds no {marker}, so it is no earlier output and is left alone. "
                "Choose another folder, or empty this one."
            )
        if Path.cwd().is_relative_to(place):
            raise OutputError(f"{path}: the output would replace the folder you are in. Choose a folder below it.")
    except OSError as error:
        raise _output_error(path, error) from error
    return place


def _take_place(new: Path, place: Path) -> None:
    """Rename `new` to `place`; what was there goes aside first, and comes back if the renaming fails."""
    if not place.exists():
        new.rename(place)
        _sync_folder(place.parent)
        return
    old = _sibling(place, "old")
    place.rename(old)
    try:
        new.rename(place)
    except BaseException:
        old.rename(place)
        raise
    _sync_folder(place.parent)
    shutil.rmtree(old, ignore_errors=True)


def _sibling(place: Path, kind: str) -> Path:
    return place.with_name(f".{place.name[:100]}.{secrets.token_hex(4)}.{kind}")


def _within(filename: Any, folder: Path) -> bool:
    return isinstance(filename, str | bytes) and Path(os.fsdecode(filename)).is_relative_to(folder)


def _sync_folder(folder: Path) -> None:
    """Force a renaming to the disk, where the system can (Windows cannot open a folder)."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _output_error(path: str | Path, error: OSError) -> OutputError:
    """An operating system's refusal in our words."""
    reason = error.strerror or str(error)
    if isinstance(error, FileNotFoundError):
        remedy = "Create the folder that it is to stand in, or choose another."
    elif isinstance(error, PermissionError) or error.errno == errno.EROFS:
        remedy = "Choose a folder that you may write to."
    elif error.errno in (errno.ENOSPC, errno.EDQUOT):
        remedy = "Free some space, or choose a folder on another disk."
    else:
        remedy = "Choose another place."
    return OutputError(f"{path}: cannot be written: {reason}. {remedy}")
