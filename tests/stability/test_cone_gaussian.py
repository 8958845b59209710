"""Hard case 16: the Gaussian of a cone's segment with t0 = t1, with t0 = 0, and with segments of any shortness.

Oracle: mpmath integrates the moments of a uniform density in the frustum, p(t) ∝ t² and a disc of radius ṙt at distance t.
"""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.render.camera import pixel_radius
from mesoshell.render.cone import cone_gaussian

mpmath.mp.dps = 60
gaussian = jax.jit(cone_gaussian)


def true_moments(t0: float, t1: float, radius: float) -> tuple[float, float, float]:
    """Mean distance, variance along, and variance across the ray."""
    a, b, r = mpmath.mpf(t0), mpmath.mpf(t1), mpmath.mpf(radius)

    def moment(k: int):
        return mpmath.mpf(mpmath.quad(lambda t: t**k, [a, b]))

    mean = moment(3) / moment(2)
    along = mpmath.mpf(mpmath.quad(lambda t: (t - mean) ** 2 * t**2, [a, b])) / moment(2)
    return float(mean), float(along), float(r * r / 4 * moment(4) / moment(2))


SEGMENTS = [(0.0, 1.0), (0.0, 1e-6), (0.0, 1e6), (1.0, 1.5), (1.0, 1.001), (1.0, 1 + 2.0**-23), (1e5, 1e5 + 0.0078125)]
SEGMENTS += [(1e-3, 1e3), (3.0, 3.2), (1e-12, 2e-12), (1e5, 1e5 + 1e-4)]


@pytest.mark.parametrize(("t0", "t1"), SEGMENTS)
def test_moments(t0: float, t1: float):
    middle, half, r = (float(np.float32(x)) for x in ((t0 + t1) / 2, (t1 - t0) / 2, 3e-3))
    found = gaussian(jnp.float32(middle), jnp.float32(half), jnp.float32(r))
    np.testing.assert_allclose(
        [float(x) for x in found], true_moments(max(middle - half, 0.0), middle + half, r), rtol=2e-6
    )


@given(st.floats(0, 1e5, width=32), st.floats(0, 1, width=32))
def test_any_segment_is_finite_ordered_and_not_negative(t: float, half: float):
    mean, along, across = (float(x) for x in gaussian(jnp.float32(t), jnp.float32(half), jnp.float32(1e-3)))
    assert np.isfinite([mean, along, across]).all()
    assert along >= 0 and across >= 0
    assert max(t - half, 0) * (1 - 1e-6) - 1e-37 <= mean <= (t + half) * (1 + 1e-6)  # denormals count as 0


@pytest.mark.parametrize(("t", "half"), [(0.0, 1.0), (0.25, 1.0), (1.0, 1.0)])
def test_what_lies_behind_the_origin_is_left_out(t: float, half: float):
    found = gaussian(jnp.float32(t), jnp.float32(half), jnp.float32(0.1))
    np.testing.assert_allclose([float(x) for x in found], true_moments(0.0, t + half, 0.1), rtol=2e-6)


@pytest.mark.parametrize("t", [0.0, 1e-30, 1e-3, 1.0, 1e5])
def test_a_segment_of_no_length_is_a_disc(t: float):
    mean, along, across = (float(x) for x in gaussian(jnp.float32(t), jnp.float32(0), jnp.float32(0.1)))
    np.testing.assert_allclose([mean, along, across], [t, 0, (0.1 * t) ** 2 / 4], rtol=1e-6, atol=1e-37)


@pytest.mark.parametrize("length", [0.0, 1e-45, 1e-30, 1e-22, 1e-20, 1e-19, 1e-10, 1.0])
@pytest.mark.parametrize("t", [0.0, 1e-30, 1e-20, 1.0, 1e5])
def test_gradients_are_finite(t: float, length: float):
    slope = jax.jacrev(cone_gaussian, (0, 1, 2))
    for part in jax.tree.leaves(slope(jnp.float32(t), jnp.float32(length), jnp.float32(1e-3))):
        assert np.isfinite(np.asarray(part)).all()


def test_a_pixels_disc_has_the_boxes_variance():
    np.testing.assert_allclose(pixel_radius(0.02) ** 2 / 4, 0.02**2 / 12)
