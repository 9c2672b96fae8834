"""The cache of mesh files: written once, into a folder that only this user can write to."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lerobot_adamanip.objects.base import Material
from lerobot_adamanip.objects.geometry.shapes import chamfered_box
from lerobot_env_adamanip.sim import articulation as mesh_files

SHAPE = chamfered_box((0, 0, 0), (0.1, 0.2, 0.3), 0.01, Material((0.5, 0.5, 0.5)))


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    forget()
    yield
    forget()


def forget() -> None:
    """As a new process would start."""
    mesh_files.cache_folder.cache_clear()


def test_a_mesh_is_written_once_and_is_what_it_was() -> None:
    path = mesh_files.mesh_file(SHAPE)
    written = path.stat().st_ino
    assert mesh_files.mesh_file(SHAPE) == path
    forget()
    assert mesh_files.mesh_file(SHAPE).stat().st_ino == written
    mesh = trimesh.load(path, process=False)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), (0.2, 0.4, 0.6), atol=1e-6)


@pytest.mark.parametrize("how", ["open to all", "a link"])
def test_a_folder_that_others_could_have_filled_is_not_used(tmp_path: Path, how: str) -> None:
    expected = tmp_path / f"adamanip_meshes_{os.getuid()}"
    if how == "a link":
        (tmp_path / "elsewhere").mkdir()
        expected.symlink_to(tmp_path / "elsewhere")
    else:
        expected.mkdir()
        expected.chmod(0o777)
    folder = mesh_files.cache_folder()
    assert folder != expected
    assert mesh_files.is_private(folder)
    assert mesh_files.mesh_file(SHAPE).parent == folder
