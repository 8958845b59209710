"""What a run lends to another: all that does not know the dataset's parameters."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.shell.material.decoder import trunk
from mesoshell.train.gan.state import TrainState, sized_for, start
from mesoshell.train.transfer import transfer_weights
from tests.helpers import small_step

AIDED = replace(small_step.CONFIG, discriminator=replace(small_step.CONFIG.discriminator, kind="vision-aided"))
OLD, NEW = sized_for(AIDED, 1, 1), sized_for(AIDED, 3, 0)


@pytest.fixture(scope="module")
def states() -> tuple[TrainState, TrainState, TrainState]:
    """One that begins, one that has learned (every number another one's), and the first with the second's weights."""
    old = start(OLD, jax.random.key(1))
    old = jax.tree.map(lambda x: x + jnp.asarray(np.random.default_rng(x.size).normal(size=x.shape), x.dtype), old)
    fresh = start(NEW, jax.random.key(2))
    return fresh, old, transfer_weights(fresh, old, NEW.appearance)


def named(tree: object) -> dict[str, np.ndarray]:
    return {jax.tree_util.keystr(path): np.asarray(x) for path, x in jax.tree_util.tree_leaves_with_path(tree)}


def test_each_weight_is_the_new_runs_or_the_old_ones(states) -> None:
    fresh, old, made = map(named, states)
    assert {k: x.shape for k, x in made.items()} == {k: x.shape for k, x in fresh.items()}
    own = ("mapping", ".averages.w", ".embed", "_adam", ".step", ".images")
    for name, x in made.items():
        if "trunk[0].kernel" not in name:
            np.testing.assert_array_equal(x, (fresh if any(part in name for part in own) else old)[name], err_msg=name)


def test_a_decoder_that_sees_no_parameter_decodes_as_the_old_one(states) -> None:
    """Features and height mean what they did; appearance, where it is 0, adds nothing."""
    _, old, made = states
    shared = np.random.default_rng(0).normal(size=(7, len(old.learner.decoder.trunk[0].kernel) - 1)).astype(np.float32)
    x = [jnp.asarray(np.pad(shared, ((0, 0), (0, n)))) for n in (1, 3)]
    for of in ("learner", "smooth"):
        a, b = (trunk(getattr(state, of).decoder, x[k]) for k, state in enumerate((old, made)))
        np.testing.assert_allclose(a[0], b[0], rtol=1e-6)
        np.testing.assert_allclose(a[1], b[1], rtol=1e-6, atol=1e-6)


def test_the_new_parameters_are_seen(states) -> None:
    fresh, _, made = states
    np.testing.assert_array_equal(made.learner.decoder.trunk[0].kernel[-3:], fresh.learner.decoder.trunk[0].kernel[-3:])
