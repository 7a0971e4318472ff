"""A first run says that it compiles; later ones find what was compiled, wherever it could be kept."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from screwpose import _compiling, jobs

_ASK = "from screwpose._compiling import must_compile; print(must_compile())"
_RUN = """
import numpy as np
from screwpose.projection.kernels import project
from screwpose.similarity.bitrow_kernels import adjoint_of
project(np.eye(3, 4), np.ones((2, 3)), np.empty(2), np.empty(2))
adjoint_of(np.zeros((2, 2)), np.ones((2, 2), np.bool_))
"""


def said(code: str, folder: Path) -> str:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120, env=environment
    )
    return done.stdout.strip()


def test_the_first_run_compiles_and_the_next_does_not(tmp_path: Path) -> None:
    assert said(_ASK, tmp_path) == "True"
    said(_RUN, tmp_path)
    assert said(_ASK, tmp_path) == "False"
    for index in tmp_path.rglob("*.nbi"):
        index.write_bytes(index.read_bytes()[:-20])  # cut short
    assert said(_ASK, tmp_path) == "True"


@pytest.mark.parametrize("first", [True, False])
def test_progress_says_so(first: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "must_compile", lambda: first)
    told = []
    jobs.saying_that_it_compiles(lambda fraction, what: told.append((fraction, what)))(0.5, "judging")
    assert told == [(0.5, "judging (compiling, once after installation)" if first else "judging")]


def test_numba_gets_a_folder_where_nothing_else_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delitem(_compiling.sys.modules, "numba", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    _compiling.ensure_cache_folder()
    assert "NUMBA_CACHE_DIR" not in os.environ  # the package or the home will do
    monkeypatch.setattr(_compiling.os, "access", lambda path, _: tmp_path in Path(path).parents)
    _compiling.ensure_cache_folder()
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    assert folder.is_dir()
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    folder.rmdir()
