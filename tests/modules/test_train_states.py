"""Flax's train states of runs: a step in Flax's way is the run's step, and the state comes back, from checkpoints too."""

from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.shell.generator.generator import draw_phases
from mesoshell.surface_material.network import SurfaceConfig, SurfaceQuery
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.fit.state import FitConfig
from mesoshell.train.gan import state
from mesoshell.train.gan.presets import TINY
from mesoshell.train.nerf_tex import network as parametric
from mesoshell.train.neutex import step as atlas
from mesoshell.train.surface import step as surface
from tests.helpers import small_step, wearing
from tests.helpers.same_trees import FIELD, same

KEY = jax.random.key(2)
SURFACE = surface.SurfaceTrainConfig(SurfaceConfig(8, 3, (8,)), batch=64)


def _answer(q: dict) -> dict:
    return {"alpha": 0.5, "cosine": 0, "rgb": 0.1}


def test_a_step_in_flax_s_way_is_the_run_s() -> None:
    begun = surface.start(SURFACE, KEY)
    batch = surface.query_batch(wearing.rows(64, 0, _answer))
    learner = ms.modules.train_states(SURFACE, begun)["surface"]
    low, high = SURFACE.curvature
    places = SurfaceQuery(batch.u, batch.radius, batch.w, (2 * batch.kappa - low - high) / (high - low))
    blur = surface.blur_at(SURFACE, jnp.zeros(()))

    def loss(params: Any) -> Any:
        def one(place: SurfaceQuery, light: Any) -> Any:
            return learner.apply_fn({"params": params}, place, light, blur)

        found, rho = jax.vmap(one)(places, batch.light)
        return surface._reflectance_loss(batch, rho) + surface._opacity_loss(SURFACE, batch, found)

    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        learner = jax.jit(lambda learner: learner.apply_gradients(grads=jax.grad(loss)(learner.params)))(learner)
    after, _ = jax.jit(partial(surface.step, SURFACE))(begun, batch)
    found = ms.modules.with_train_states(SURFACE, begun, {"surface": learner})
    assert jax.tree.structure(found) == jax.tree.structure(after)
    for x, y in zip(jax.tree.leaves(found.surface), jax.tree.leaves(after.surface), strict=True):
        np.testing.assert_allclose(x, y, atol=1e-5)
    assert found.step == after.step == 1


def _gan() -> tuple[Any, Any]:
    return small_step.CONFIG, jax.jit(partial(state.start, small_step.CONFIG))(KEY)


def _atlas() -> tuple[Any, Any]:
    config = atlas.NeuTexTrainConfig(FIELD)
    return config, atlas.start(config, KEY)


def _parametric() -> tuple[Any, Any]:
    config = parametric.nerf_tex_config(TINY)
    return config, parametric.start(config, KEY)


@pytest.mark.parametrize(
    ("run", "names"),
    [(_gan, {"learner", "discriminator"}), (_atlas, {"field"}), (_parametric, {"decoder"})],
)
def test_players_are_taken_out_of_a_run_s_state_and_put_back(run: Any, names: set[str]) -> None:
    config, begun = run()
    states = ms.modules.train_states(config, begun)
    assert states.keys() == names
    same(ms.modules.with_train_states(config, begun, states), begun)
    for name, mine in states.items():
        same(mine.opt_state, mine.tx.init(mine.params))
        other = mine.replace(params=jax.tree.map(lambda x: x + 1, mine.params), step=mine.step + 7)
        moved = ms.modules.with_train_states(config, begun, {name: other})
        same(ms.modules.train_states(config, moved)[name].params, other.params)
        assert moved.step == 7
        for rest in names - {name}:
            same(ms.modules.train_states(config, moved)[rest].params, states[rest].params)


def test_a_learner_s_apply_is_its_generator_s() -> None:
    config, begun = _gan()
    learner = ms.modules.train_states(config, begun)["learner"]
    phases = draw_phases(config.generator, KEY, 1)
    z, beta = jnp.ones((1, config.generator.z)), jnp.ones((1, 1))
    variables = {"params": learner.params, "averages": begun.averages}
    texture, _ = jax.eval_shape(learner.apply_fn, variables, z, beta, phases, jnp.zeros(2, jnp.int32))
    assert texture.feature.shape == (1, 16, 16, 4)


def test_train_states_of_a_checkpoint(tmp_path: Path) -> None:
    begun = surface.start(SURFACE, KEY)
    with Checkpoints(tmp_path) as kept:
        kept.save(3, begun)
    with Checkpoints(tmp_path, reading=True) as kept:
        found = kept.newest(jax.eval_shape(lambda: begun))
    assert found is not None
    same(
        ms.modules.train_states(SURFACE, found[1])["surface"].params,
        ms.modules.train_states(SURFACE, begun)["surface"].params,
    )


def test_a_fit_of_patches_has_none() -> None:
    with pytest.raises(InputError, match="config: a fit of patches has no train state"):
        ms.modules.train_states(FitConfig(), None)
