"""Tests leave no meshes in the user's cache, and find none there."""

import pytest

from screwpose.implants.mesh_cache import VARIABLE, forget


@pytest.fixture(scope="session", autouse=True)
def own_mesh_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """One folder for the whole run; processes that tests start use it too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, str(tmp_path_factory.mktemp("meshes")))
        forget()
        yield
