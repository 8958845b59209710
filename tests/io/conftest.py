"""A small material and the two things that every test of a fault needs.

The texture has 4 × 8 texels of 3 channels, the height feature 5 rows, the trunk widths 6 and 5, the head width 4.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, Parameter


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
