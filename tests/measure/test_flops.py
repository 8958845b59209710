"""Operations are counted as they are on paper."""

import jax
import jax.numpy as jnp

from mesoshell.measure.flops import count_operations

A, B = jnp.zeros((3, 5)), jnp.zeros((5, 7))


def test_a_product() -> None:
    assert count_operations(jnp.matmul, A, B) == 2 * 3 * 5 * 7


def test_a_loop_counts_every_turn() -> None:
    assert count_operations(lambda a: jax.lax.map(lambda x: x @ B, a), jnp.zeros((11, 3, 5))) == 11 * 2 * 3 * 5 * 7


def test_a_gradient_has_two_more_products() -> None:
    assert count_operations(jax.jit(jax.grad(lambda a, b: jnp.sum((a @ b) ** 2), (0, 1))), A, B) == 3 * 2 * 3 * 5 * 7


def test_the_dearest_branch_counts() -> None:
    def either(a):
        return jax.lax.cond(a[0, 0] > 0, lambda a: a @ B @ B.T, lambda a: a, a)

    assert count_operations(either, A) == 2 * 2 * 3 * 5 * 7


def test_a_convolution() -> None:
    def convolve(x, w):
        return jax.lax.conv_general_dilated(x, w, (1, 1), "VALID", dimension_numbers=("NHWC", "HWIO", "NHWC"))

    found = count_operations(convolve, jnp.zeros((2, 8, 9, 4)), jnp.zeros((3, 3, 4, 6)))
    assert found == 2 * (2 * 6 * 7 * 6) * (3 * 3 * 4)
