"""Small files of every kind that readers are tried with, and what they may do: an InputError of one line, or nothing."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from mesoshell.errors import InputError
from mesoshell.io.image import write_exr, write_png

Reader = Callable[[Path], Any]


@pytest.fixture
def refuses() -> Callable[..., str]:
    def refuses(read: Callable, *arguments: Any) -> str:
        with pytest.raises(InputError) as caught:
            read(*arguments)
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 1200
        return str(caught.value)

    return refuses


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files that are well."""
    folder = tmp_path_factory.mktemp("good")
    ball = trimesh.creation.icosphere(1)
    for kind in ("obj", "ply", "stl", "glb", "off"):
        ball.export(folder / f"ball.{kind}")
    random = np.random.default_rng(0)
    write_exr(folder / "a.exr", random.random((6, 5, 4), np.float32))
    write_png(folder / "a.png", random.random((6, 5, 3), np.float32))
    np.savez(folder / "cameras.npz", world_mat_0=np.eye(4), scale_mat_0=np.eye(4))
    packed(folder / "packed")
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist(), "fl_x": 5, "w": 5, "h": 6}
    (folder / "transforms.json").write_text(json.dumps({"frames": [frame]}))
    return folder


def packed(folder: Path) -> None:
    """A packed dataset of three images of 6 × 4."""
    (folder / "shards").mkdir(parents=True)
    np.save(folder / "shards/0000.npy", np.random.default_rng(1).random((3, 4, 6, 4)).astype(np.float16))
    manifest = {"schema": 1, "alpha": "premultiplied", "recipe": "grass", "version": 1, "field_of_view": 0.5, "seed": 0}
    manifest |= {"parameters": {}, "radius_range": [1, 2], "size": [6, 4], "samples_per_pixel": 4, "count": 3}
    (folder / "manifest.json").write_text(json.dumps(manifest | {"packed": "half"}))
    row = {"seed": 0, "size": [6, 4], "camera_to_world": np.eye(4).tolist(), "fov": 0.5, "radius": 2.0}
    row |= {"light": [0, 0, 1], "irradiance": [1, 1, 1], "parameters": {}, "sha256": "0" * 64}
    rows = [row | {"index": i, "row": i, "file": "shards/0000.npy"} for i in range(3)]
    (folder / "samples.jsonl").write_text("".join(json.dumps(r) + "\n" for r in rows))
