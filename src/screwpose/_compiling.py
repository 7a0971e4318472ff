"""Is the compiled code there already? Numba compiles on first use, and keeps it on disk beside the modules.

Where neither the package nor the user's cache folder can be written, numba would refuse to load a kernel that wants to
be kept: then a folder that lives as long as the process is given to it.
"""

import os
import sys
from importlib import import_module
from pathlib import Path

NOTE = "compiling, once after installation"

# In every solve one function of each of these is called.
_MODULES = ("screwpose.projection.kernels", "screwpose.similarity.bitrow_kernels")
_FOLDER_VARIABLE = "NUMBA_CACHE_DIR"


def must_compile() -> bool:
    """Whether a solve will first compile: there is a module none of whose functions is kept, as it stands, on disk."""
    return any(not _is_kept(name) for name in _MODULES)


def _is_kept(module: str) -> bool:
    from numba.core.dispatcher import Dispatcher

    functions = [one for one in vars(import_module(module)).values() if isinstance(one, Dispatcher)]
    own = [one for one in functions if one.py_func.__module__ == module]
    return any(_is_on_disk(one) for one in own)


def _is_on_disk(function: object) -> bool:
    """Whether numba has an overload of a function on disk; true where a later numba does not tell."""
    if getattr(function, "signatures", ()):
        return True  # compiled or loaded in this process
    import pickle

    index = getattr(getattr(function, "_cache", None), "_cache_file", None)
    load = getattr(index, "_load_index", None)
    if load is None:
        return True
    try:
        return bool(load())
    except (OSError, EOFError, ValueError, pickle.UnpicklingError, AttributeError, ImportError):
        return False  # a damaged file: numba compiles again


def ensure_cache_folder() -> None:
    """Give numba a folder of this process where it could keep nothing else; called before it is imported."""
    if os.environ.get(_FOLDER_VARIABLE) or "numba" in sys.modules:
        return
    package = Path(__file__).parent
    if os.access(package, os.W_OK) or _could_make(_users_folder()):
        return
    import atexit
    import shutil
    import tempfile

    folder = tempfile.mkdtemp(prefix="screwpose-numba-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[_FOLDER_VARIABLE] = folder


def _users_folder() -> Path:
    """Where numba keeps what it may not keep beside the modules, roughly: the folder that must be writable for it."""
    home = Path(os.environ.get("HOME") or os.environ.get("USERPROFILE") or "/")
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home)
    return (
        home / "Library" / "Caches"
        if sys.platform == "darwin"
        else Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    )


def _could_make(folder: Path) -> bool:
    there = next((one for one in (folder, *folder.parents) if one.exists()), None)
    return there is not None and there.is_dir() and os.access(there, os.W_OK)
