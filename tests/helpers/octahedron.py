"""A captured object whose density is known, and a camera that sees it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.nets.encoding import HashConfig
from mesoshell.nets.mlp import Dense
from mesoshell.neutex.cameras import Photo
from mesoshell.neutex.field import Field, FieldConfig, init_field
from mesoshell.neutex.store import NeuTexModel
from mesoshell.render.camera import look_at

CONFIG = FieldConfig((16, 16), (16,), (8, 8), (8, 8), 8, "hash", octaves=(2, 2, 1), hash=HashConfig(3, 2, 8, 4, 12))
PHOTO = Photo(look_at((2.5, 1.0, 1.5), (0, 0, 0), (0, 0, 1)), (20.0, 20.0, 10.0, 8.0), 20, 16)


def octahedron(config: FieldConfig = CONFIG) -> Field:
    """An octahedron of fog, σ = 25 softplus(6 − 10 |y|₁), with random colours that views change."""
    made: Any = init_field(config, jax.random.key(3))
    ways = np.concatenate([np.eye(3), -np.eye(3)], axis=1)
    first, second = np.zeros((9, 16), np.float32), np.zeros((16, 16), np.float32)
    first[:3, :6], second[:6, :6] = ways, np.eye(6)
    bias = jnp.zeros_like(made.sigma.last.bias).at[0].set(6.0)
    last = np.zeros((16, len(bias)), np.float32)
    last[:6, 0] = -10
    hidden = [Dense(jnp.asarray(k), jnp.zeros(16)) for k in (first, second)]
    made = made._replace(sigma=made.sigma._replace(hidden=hidden, last=Dense(jnp.asarray(last), bias)))
    if config.colour != "texture":
        return made
    return made._replace(
        texture=made.texture._replace(tables=made.texture.tables * 1e4),
        view=made.view._replace(last=made.view.last._replace(kernel=made.view.last.kernel * 10)),
    )


def model(
    field: Field, config: FieldConfig = CONFIG, centre: tuple = (0.0, 0.0, 0.0), half: float = 1.0
) -> NeuTexModel:
    return NeuTexModel(config, field, np.array(centre), half, (PHOTO, PHOTO), (1,), {"rays": 5})
