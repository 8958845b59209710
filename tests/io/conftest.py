"""A small material, a small dataset on disk, and the form of a fault.

The material's texture has 4 × 8 texels of 3 channels, its height feature 5 rows, the trunk widths 6 and 5, the head 4.
The dataset has three images of 6 × 4 pixels.
"""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, Parameter
from mesoshell.io.image import write_exr


@pytest.fixture
def bundle() -> Bundle:
    shapes: dict[str, tuple[int, ...]] = {f"features/{i}": (max(1, 4 >> i), 8 >> i, 3) for i in range(4)}
    shapes |= {f"height/{i}": (rows, 3) for i, rows in enumerate([5, 2, 1])}
    shapes |= {f"grid/{i}": (2, 3, 4 - i) for i in range(4)}
    layers = {"trunk/0": (3 + 5 + 1, 6), "trunk/1": (6, 5), "sigma": (5, 1), "head/0": (5 + 6, 4), "rho": (4, 3)}
    for name, (inputs, outputs) in layers.items():
        shapes |= {f"decoder/{name}/kernel": (inputs, outputs), f"decoder/{name}/bias": (outputs,)}
    rng = np.random.default_rng(0)
    arrays = {key: rng.random(shape, np.float32) for key, shape in shapes.items()}
    return Bundle(
        kind="shell",
        texel_density=256.0,
        channels=3,
        height_octaves=2,
        parameters=(
            Parameter("age", "alpha", (0.0, 1.0), 0.25, "", "from fresh to dry"),
            Parameter("length", "beta", (1.0, 3.0), 2.0, "cm", "length of a blade"),
        ),
        thickness=0.5,
        colour_space="linear Rec. 709",
        provenance={"config": {"recipe": "grass"}, "metrics": {"psnr": 31.5}},
        arrays=arrays | {"sigma_scale": np.array(30, np.float32)},
    )


@pytest.fixture
def fault_of() -> Callable[..., str]:
    """Calls with a path and more, and gives the fault without the path with which its one line must begin."""

    def fault_of(call: Callable, path: Path, *args: Any) -> str:
        with pytest.raises(InputError) as caught:
            call(path, *args)
        text = str(caught.value)
        assert text.startswith(f"{path}: ") and "\n" not in text
        return text.removeprefix(f"{path}: ")

    return fault_of


SETTINGS: dict[str, Any] = {
    "schema": 1,
    "recipe": "grass",
    "version": 3,
    "alpha": "premultiplied",
    "field_of_view": 0.6,
    "parameters": {"age": {"role": "alpha", "range": [0, 1], "default": 0.5, "unit": "", "meaning": "dryness"}},
    "radius_range": [2.0, 3.0],
    "size": [6, 4],
    "samples_per_pixel": 16,
    "seed": 7,
    "count": 3,
}


class DatasetFolder:
    """A dataset whose parts can be rewritten."""

    settings = SETTINGS

    def __init__(self, path: Path):
        self.path, self.rows, self.manifest_file = path, path / "samples.jsonl", path / "manifest.json"
        (path / "images").mkdir(parents=True)
        self.manifest(SETTINGS)
        self.write([self.sample(i) for i in range(3)])

    def image(self, index: int) -> Path:
        return self.path / f"images/{index:06d}.exr"

    def sample(self, index: int, image: np.ndarray | None = None) -> dict[str, Any]:
        """Write an image, grey of value (1 + index) / 8 unless given, and make its row."""
        write_exr(self.image(index), np.full((4, 6, 4), (1 + index) / 8, np.float32) if image is None else image)
        return {
            "index": index,
            "file": f"images/{index:06d}.exr",
            "sha256": hashlib.sha256(self.image(index).read_bytes()).hexdigest(),
            "seed": 2**31 + index,
            "size": [6, 4],
            "parameters": {"age": 0.25 * index},
            "camera_to_world": np.eye(4).tolist(),
            "fov": 0.6,
            "radius": 2.5,
            "light": [0.6, 0, 0.8],
            "irradiance": [1, 2, 3],
        }

    def manifest(self, content: Any) -> None:
        self.manifest_file.write_text(json.dumps(content))

    def write(self, rows: list[dict[str, Any]]) -> None:
        self.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))

    def read_rows(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.rows.read_text().splitlines()]

    def change_row(self, index: int, fields: dict[str, Any]) -> None:
        rows = self.read_rows()
        rows[index] |= fields
        self.write(rows)

    def damage(self, index: int, image: np.ndarray) -> None:
        """Another image, with a row that knows its digest."""
        rows = self.read_rows()
        rows[index] = self.sample(index, image)
        self.write(rows)


@pytest.fixture
def folder(tmp_path: Path) -> DatasetFolder:
    return DatasetFolder(tmp_path / "set")
