"""Geometry that varies over a texture: a constant field changes nothing, a step stays where it is, tiles show no seams."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mesoshell.shell.generator.bake as bake
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.shell.generator.generator import init_averages, init_generator
from mesoshell.shell.generator.model import GeneratorModel, generator_model, grown
from mesoshell.shell.generator.nodes import hat, window
from mesoshell.shell.generator.plan import GeneratorConfig, reach
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle, field_of, grow
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.shell.material.field import Point, inputs
from mesoshell.shell.material.loader import load_device_material
from tests.helpers import growing

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("nodes")

TEXELS, SIZE = growing.TEXELS, (70, 150)


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return growing.bundle()


@pytest.fixture(scope="module")
def far(bundle) -> int:
    return reach(generator_model(bundle, "it").config, (64, 64))


def made(bundle: Bundle, field, size=SIZE) -> Bundle:
    return bake_bundle(bundle, "it", size, TextureRequest(7, {}, {"length": field}))[0]


def ends(bundle: Bundle, size=SIZE) -> list[np.ndarray]:
    """Textures of the least and of the greatest length."""
    found = [bake_bundle(bundle, "it", size, TextureRequest(7, {"length": x}))[0] for x in (1.0, 3.0)]
    return [x.arrays["features/0"].astype(np.float32) for x in found]


def test_a_constant_field_is_the_constant(bundle) -> None:
    size = (35, 70)
    varying = made(bundle, lambda at: np.full(at.shape[:-1], 0.25), size)
    same = bake_bundle(bundle, "it", size, TextureRequest(7, {"length": 1.5}))[0]
    for key in same.arrays:
        rounding = 1 / 16 if key.startswith("grid/") else 0  # bounds keep four bits
        np.testing.assert_allclose(varying.arrays[key], same.arrays[key], rtol=2e-3 + rounding, atol=2e-3, err_msg=key)
    assert varying.arrays["heights/0"].shape == (4, 6, *same.arrays["height/0"].shape)
    found, expected = load_device_material(varying), load_device_material(same)
    for xi in ([0.3, 0.2, 0.1], [4.3, 2.1, 0.9], [2.0, 1.0, 0.5]):
        point = Point(jnp.array(xi), jnp.zeros(()), jnp.zeros(()), jnp.zeros(1))
        a, b = (inputs(x.material, x.layout, point) for x in (found, expected))
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-3)


def test_each_side_of_a_step_is_the_texture_of_its_side(bundle, far, monkeypatch) -> None:
    """β is 0 up to u = 4 and 1 from u = 5: beyond the layers' reach of the step, the texture knows nothing of it."""
    growing.without_grids(monkeypatch)
    found = made(bundle, lambda at: (at[..., 0] > 4.5).astype(float)).arrays["features/0"].astype(np.float32)
    low, high = ends(bundle)
    left, right = (4 - far) * TEXELS, (5 + far) * TEXELS
    assert left > 0 and right < SIZE[1]
    np.testing.assert_allclose(found[:, :left], low[:, :left], rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(found[:, right:], high[:, right:], rtol=2e-3, atol=2e-3)
    assert np.abs(low - high).max() > 0.05 * low.std()


def test_tiles_show_no_seams(bundle, monkeypatch) -> None:
    """A texture of 4 tiles of 4 × 4 patches, and the same of 9 of 2 × 2."""

    def ramp(at: np.ndarray) -> np.ndarray:
        return np.clip(at[..., 0] / 12 + at[..., 1] / 20, 0, 1)

    growing.without_grids(monkeypatch)
    whole = made(bundle, ramp, (70, 80))
    monkeypatch.setattr(bake, "MAX_PATCHES", 2)
    again = made(bundle, ramp, (70, 80))
    for key in ("features/0", "features/4", "heights/0"):
        np.testing.assert_allclose(again.arrays[key], whole.arrays[key], rtol=2e-3, atol=1e-3)


def test_a_surface_asks_the_field_where_it_lies(bundle, monkeypatch) -> None:
    """The nodes of a texture that begins at an origin are those of the plane."""
    growing.without_grids(monkeypatch)
    seen = []
    uv = np.array([[[3.2, -1.9], [4.1, -1.8], [3.3, -0.7]]], np.float32)
    found, origin = grow(
        bundle, "it", uv, TextureRequest(0, {}, {"length": lambda at: seen.append(at) or at[..., 0] * 0})
    )
    assert origin == (2, -3)
    np.testing.assert_array_equal(seen[0][0, 0], origin)
    assert seen[0].shape[:2] == found.arrays["heights/0"].shape[:2]


def test_it_is_a_bundle(bundle, tmp_path) -> None:
    write_bundle(tmp_path / "a.npz", made(bundle, lambda at: at[..., 1] / 5, (70, 40)))
    found = read_bundle(tmp_path / "a.npz")
    assert found.provenance["varies"] == ["length"]
    layout = load_device_material(found).layout
    assert layout.nodes == (6, 4)
    point = Point(jnp.array([1.3, 2.1, 0.4]), jnp.zeros(()), jnp.zeros(()), jnp.zeros(1))
    value, back = jax.vjp(lambda p: inputs(load_device_material(found).material, layout, p), point)
    assert all(jnp.isfinite(x).all() for x in jax.tree.leaves((value, back(jnp.ones_like(value)))))


def test_heights_at_a_node_are_its_own(bundle, monkeypatch) -> None:
    """A node's F(h) is that of a texture with its β everywhere; halfway between two, their mean."""
    growing.without_grids(monkeypatch)
    found = made(bundle, lambda at: (at[..., 0] >= 2).astype(float), (32, 64))
    for u, beta in ((1, 1.0), (2, 3.0)):
        alone = bake_bundle(bundle, "it", (16, 16), TextureRequest(7, {"length": beta}))[0].arrays["height/0"]
        np.testing.assert_allclose(found.arrays["heights/0"][1, u], alone, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("first", [-7, 0, 5])
def test_hats_interpolate_linear_functions(first) -> None:
    """Weights are a partition of unity, and give back a linear function of place."""
    a = hat(first, 40, 16.0, 2, 8)
    at = (first + np.arange(40) + 0.5) / 16
    np.testing.assert_allclose(a.sum(axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(a @ (np.arange(8) - 2.0), at, rtol=0, atol=1e-5)


def test_windows_repeat_the_outermost_nodes() -> None:
    nodes = jnp.arange(6.0).reshape(1, 2, 3, 1)
    np.testing.assert_array_equal(window(nodes, (-1, 1), 3)[0, ..., 0], [[1, 2, 2], [1, 2, 2], [4, 5, 5]])


def test_an_image_lies_with_its_last_row_at_v_0() -> None:
    image = np.array([[0.1, 0.2], [0.3, 0.4]])
    at = np.array([[0.5, 0.5], [3.5, 0.5], [0.5, 3.5], [4.5, 4.5]])
    np.testing.assert_array_equal(field_of(image, (4.0, 4.0), True)(at), [0.3, 0.4, 0.1, 0.3])
    np.testing.assert_array_equal(field_of(image, (4.0, 4.0), False)(at), [0.3, 0.4, 0.1, 0.2])


def test_a_generator_without_geometry_parameters_has_one_latent() -> None:
    config = GeneratorConfig(16, "T", 64, 4, channels=4, layers=4, z=4, w=4, height_rows=8, height_width=4)
    generator = init_generator(config, jax.random.key(0))
    maker = GeneratorModel(config, generator, init_averages(config), init_decoder(jax.random.key(1), 7, (4,), (4,)), 1)
    assert grown(maker, 0, np.zeros(0, np.float32)).w.shape == (1, 4)
