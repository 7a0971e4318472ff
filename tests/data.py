"""The one door to the shared data: real X-rays, implants, spines and CT that are too large for the repository."""

import os
from pathlib import Path

import pytest


def data_folder() -> Path:
    """The folder of the shared data: ``$SCREWPOSE_DATA``, else ``../shared/data`` beside the repository."""
    named = os.environ.get("SCREWPOSE_DATA")
    return Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"


def shared_data(name: str) -> Path:
    """The path of a shared file or folder; skips the test, saying what is missing, where it is absent."""
    path = data_folder() / name
    if not path.exists():
        pytest.skip(f"shared data absent: {path} (set SCREWPOSE_DATA to the folder that holds it)")
    return path
