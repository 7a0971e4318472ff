"""Which server a case folder belongs to for now: two of them must not write over each other.

The file `.workbench-owner` in the folder names the server, and its time of change says that it lives. Who looks at it
or writes the case holds the file's lock meanwhile, so that nothing comes between asking and writing.
"""

import contextlib
import json
import os
import secrets
import socket
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from screwpose.errors import OutputError

OWNER_NAME = ".workbench-owner"
# A server renews its claim every second or two. A longer silence is the end of it: of another computer nothing else
# tells. Where it is only slow, it learns of the loss before it writes again.
_DEAD_AFTER_S = 30.0
_LONGEST = 2000


@dataclass(frozen=True)
class Owner:
    """A server: `token` is drawn by chance, since a process's number comes again."""

    token: str
    pid: int
    host: str


class Claim:
    """One server's claim to one case folder; `other` is who else had it when it was last looked at."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / OWNER_NAME
        self._own = Owner(secrets.token_hex(8), os.getpid(), socket.gethostname())
        self.other: Owner | None = None

    def renew(self, takes: bool = False) -> None:
        """Claim the folder, or say that the claim still holds, unless another server has it; `takes` it from that one.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        with self._looked_at(takes):
            pass

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """While this lasts, nobody else can claim the folder: for writing.

        Raises
        ------
        OutputError
            Another server has it, or it cannot be written.
        """
        with self._looked_at(takes=False):
            if self.other is not None:
                raise OutputError(
                    f"{self._file.parent}: the case is open in another workbench (process {self.other.pid} on "
                    f"{self.other.host}). Nothing was overwritten: take over to go on here."
                )
            yield

    def release(self) -> None:
        """Leave the folder to whoever wants it. The file stays: whoever waits for its lock has it open.

        Where that cannot be, as in a folder of another user, its silence tells the others.
        """
        with contextlib.suppress(OSError), _locked(self._file, os.O_RDWR) as handle:
            if _read(handle) == self._own:
                os.ftruncate(handle, 0)

    @contextlib.contextmanager
    def _looked_at(self, takes: bool) -> Iterator[None]:
        with contextlib.ExitStack() as stack:
            try:
                handle = stack.enter_context(_locked(self._file, os.O_RDWR | os.O_CREAT))
                owner = _read(handle)
                if owner is None or owner == self._own or takes or _is_dead(owner, os.fstat(handle).st_mtime):
                    _write(handle, self._own)
                    _share(handle, self._file.parent)
                    owner = None
            except OSError as error:
                raise OutputError(
                    f"{self._file.parent}: cannot be written: {error.strerror}. The case can only be looked at."
                ) from error
            self.other = owner
            yield


def _is_dead(owner: Owner, changed: float) -> bool:
    if datetime.now().timestamp() - changed > _DEAD_AFTER_S:
        return True
    if owner.host != socket.gethostname() or sys.platform == "win32":  # where signal 0 would end the process
        return False
    try:
        os.kill(owner.pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        return False  # somebody else's, and alive
    return False


def _read(handle: int) -> Owner | None:
    """Whom the file names; nobody where it is empty, or was cut off by the end of who wrote it."""
    os.lseek(handle, 0, os.SEEK_SET)
    try:
        said = json.loads(os.read(handle, _LONGEST))
        return Owner(str(said["token"]), int(said["pid"]), str(said["host"]))
    except (ValueError, KeyError, TypeError):
        return None


def _write(handle: int, owner: Owner) -> None:
    os.lseek(handle, 0, os.SEEK_SET)
    os.ftruncate(handle, os.write(handle, json.dumps(asdict(owner)).encode()))


def _share(handle: int, folder: Path) -> None:
    """Whoever may write the folder may claim it: without, a colleague in a shared one would be kept out for good."""
    if sys.platform == "win32":
        return
    rights, own = folder.stat(), os.fstat(handle)
    if own.st_uid == os.geteuid() and own.st_mode & 0o666 != rights.st_mode & 0o666:
        with contextlib.suppress(OSError):  # a group that is not ours to give
            os.fchown(handle, -1, rights.st_gid)
        with contextlib.suppress(OSError):  # a disk without rights
            os.fchmod(handle, rights.st_mode & 0o666)


@contextlib.contextmanager
def _locked(file: Path, flags: int) -> Iterator[int]:
    """The file, open, with nobody else in here. The lock ends with the process, however that ends."""
    handle = os.open(file, flags, 0o666)
    try:
        _lock(handle)
        yield handle
    finally:
        os.close(handle)


def _lock(handle: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, 2**20, os.SEEK_SET)  # beyond what is read: there a lock keeps others from reading
        msvcrt.locking(handle, msvcrt.LK_LOCK, 1)
        return
    import fcntl

    # A file system without locks: the claim is told apart all the same, only not within the same milliseconds.
    with contextlib.suppress(OSError):
        fcntl.flock(handle, fcntl.LOCK_EX)
