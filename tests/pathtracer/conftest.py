"""Materials that several files here trace. The path tracer makes Mitsuba ready before any file here imports it."""

from pathlib import Path

import numpy as np
import pytest

import mesoshell.pathtracer  # noqa: F401
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.bundle import write_bundle
from mesoshell.io.surface import write_surface
from tests.helpers import wearing
from tests.helpers.path_traced import WHOLE, constant


@pytest.fixture(scope="module")
def materials(tiny_bundle, tmp_path_factory) -> Path:
    """thin.npz, dense.npz, and rough.npz, which varies."""
    folder = tmp_path_factory.mktemp("materials")
    write_bundle(folder / "thin.npz", constant(tiny_bundle, 1.0, 0.2))
    write_bundle(folder / "dense.npz", constant(tiny_bundle, 300.0, 1 / WHOLE))
    write_bundle(folder / "rough.npz", tiny_bundle)
    (folder / "box.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n"
    )
    return folder


def meshes() -> dict[str, Mesh]:
    low, high = wearing.square(), wearing.moved(wearing.square(), 0, 0, 1.0)
    return {
        "square": low,
        "roofed": wearing.joined(low, wearing.turned(high)),
        "ball": wearing.ball(1.0),
        "few": wearing.ball(0.6, 7, 5),
        "pair": wearing.joined(wearing.moved(wearing.ball(0.3), 0, 0, 2.0), wearing.ball(1.0, 64, 32)),
        "lump": wearing.lump(),
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory, tiny_bundle) -> Path:
    """Materials by name: opaque, half, none; white, of which all light comes back; rough, which varies, solid, which varies and
    is opaque; and shells, of black fog and of mist."""
    made = tmp_path_factory.mktemp("materials")
    write_surface(made / "opaque.npz", wearing.constant(1.0, 0.2))
    write_surface(made / "half.npz", wearing.constant(0.5, 0.2))
    write_surface(made / "none.npz", wearing.constant(0.0, 5.0))
    write_surface(made / "white.npz", wearing.constant(1.0, 1 / (4 * np.pi)))
    write_surface(made / "rough.npz", wearing.bundle())
    write_surface(made / "solid.npz", wearing.bundle(opacity="none"))
    write_surface(made / "other.npz", wearing.bundle(seed=3, channels=5, hidden=(6, 7), texels=4))
    write_bundle(made / "fog.npz", constant(tiny_bundle, 1.0, 1e-6))
    write_bundle(made / "mist.npz", constant(tiny_bundle, 1.0, 0.2))
    for name, mesh in meshes().items():
        wearing.write_obj(made / f"{name}.obj", mesh)
    return made
