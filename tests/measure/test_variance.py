"""Analysis of variance of density, where it is known."""

import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.measure.variance import shares
from mesoshell.nets.mlp import Dense
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.field import Layout, Material
from mesoshell.texture import mip

SIDE = 16


def material(plane: float, height: float) -> tuple[Layout, Material]:
    """log σ is nearly the raw value where that is far below 0: −20 + plane · checks of (u, v) + height · checks of h."""
    checks = jnp.asarray(np.indices((SIDE, SIDE)).sum(axis=0) % 2 * 2.0 - 1.0, jnp.float32)[..., None]
    layers = jnp.asarray(np.arange(SIDE) % 2 * 2.0 - 1.0, jnp.float32)[:, None, None]
    pick = Dense(jnp.array([[1.0], [0.0]], jnp.float32), jnp.full(1, 10.0, jnp.float32))
    minus = Dense(jnp.ones((1, 1), jnp.float32), jnp.full(1, -27.0, jnp.float32))
    decoder = Decoder([pick], minus, [pick], pick, jnp.ones((), jnp.float32))
    layout = Layout(((SIDE, SIDE),), ((SIDE, 1),), float(SIDE), 0)
    return layout, Material(mip.pack([plane * checks]), mip.pack([height * layers]), decoder)


@pytest.mark.parametrize(("plane", "height"), [(1.0, 0.0), (0.0, 1.0), (1.0, 2.0), (0.5, 0.5)])
def test_shares_of_a_sum_are_those_of_its_parts(plane: float, height: float) -> None:
    found = shares(*material(plane, height), jnp.zeros(0), SIDE)
    whole = plane**2 + height**2
    np.testing.assert_allclose(found, (plane**2 / whole, height**2 / whole), atol=1e-4)


def test_fog_has_none() -> None:
    assert np.asarray(shares(*material(0.0, 0.0), jnp.zeros(0), SIDE)).max() < 1e-6
