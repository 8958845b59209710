"""What losses and networks see of a radiance."""

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.io.image import linear_to_srgb
from mesoshell.render.composite import encoded


def test_encoded_is_srgb_and_linear_below_the_knee() -> None:
    """Negative values too; gradients are finite."""
    x = np.linspace(-0.2, 2, 100).astype(np.float32)
    wanted = np.where(x < 0, 12.92 * x, linear_to_srgb(np.maximum(x, 0)))
    np.testing.assert_allclose(encoded(jnp.asarray(x)), wanted, atol=1e-5)
    assert bool(jnp.isfinite(jax.vmap(jax.grad(encoded))(jnp.asarray(x))).all())
