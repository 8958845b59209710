"""σ from a grid in JAX is the network's where the grid has a column, and linear between."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.io.bundle import Bundle
from mesoshell.io.density_grid import K, grid_shape
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle
from mesoshell.shell.material import baked_density
from mesoshell.shell.material.baked_density import bake, sigma_at
from mesoshell.shell.material.field import Point, neural_field
from mesoshell.shell.material.loader import DeviceMaterial, load_device_material
from tests.helpers import growing

ORIGIN = (-2, 3)


@pytest.fixture(scope="module")
def edged() -> Bundle:
    """A texture with edges, of 3 × 2 patches."""
    return bake_bundle(growing.bundle(), "it", (32, 48), TextureRequest(7))[0]


@pytest.fixture(scope="module")
def shaped() -> Bundle:
    """The same with geometry that varies over it, so with a height feature at each node."""
    name = next(p.name for p in growing.bundle().parameters if p.role == "beta")
    return bake_bundle(
        growing.bundle(), "it", (32, 48), TextureRequest(7, fields={name: lambda uv: np.clip(uv[..., 0] / 3, 0, 1)})
    )[0]


def by_network(it: DeviceMaterial, xi: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    field, zero = neural_field(it.material_for(filtering=False), it.layout), jnp.float32(0)
    return np.asarray(jax.vmap(lambda x: field.density(Point(x, zero, zero, jnp.asarray(alpha)))[0])(jnp.asarray(xi)))


def by_grid(it: DeviceMaterial, shape: tuple[int, ...], numbers: np.ndarray, xi: np.ndarray, varying=()) -> np.ndarray:
    given = jnp.asarray(np.asarray(varying, np.float32))
    read = partial(sigma_at, it.layout, shape, jnp.asarray(numbers))
    return np.asarray(jax.vmap(lambda x: read(x, given, it.material.origin))(jnp.asarray(xi)))


def on_columns(it: DeviceMaterial, columns: int, count: int = 500) -> np.ndarray:
    """Points of the grid within the texture, (count, 3); of corner tiles those that do not read across a border."""
    rng = np.random.default_rng(0)
    height, width = it.layout.sizes[0]
    fine = int(columns * it.layout.texel_density)
    place = [rng.integers(0, columns * n, count) for n in (width, height)]
    wide = [fine] * 2 if it.layout.open else [columns * n // it.layout.period for n in (width, height)]
    if it.layout.colours is not None:
        beside = columns - 1
        place = [x - x % fine + beside + x % (fine - 2 * beside) for x in place]
    at = [(x + 0.5) / n for x, n in zip(place, wide, strict=True)]
    if it.layout.open:
        at = [x + begin for x, begin in zip(at, ORIGIN, strict=True)]
    return np.stack([*at, (rng.integers(0, K, count) + 0.5) / K], axis=1).astype(np.float32)


def flat(bundle: Bundle) -> Bundle:
    """With half of the lines in a patch."""
    count = sum(name.startswith("features/") for name in bundle.arrays)
    levels = {f"features/{i}": bundle.arrays[f"features/{i}"] for i in range(count)}
    return replace(bundle, arrays=bundle.arrays | {k: x[: max(1, len(x) // 2)] for k, x in levels.items()})


@pytest.mark.parametrize("columns", [pytest.param(1, marks=pytest.mark.slow), 2])
@pytest.mark.parametrize("name", ["tiny", "flat", "tiled", "edged", "shaped"])
def test_a_grid_holds_what_the_network_says(name, columns, tiny_bundle, tiled_bundle, edged, shaped, monkeypatch):
    """At its own points, to half precision; of one value of a parameter, or at both ends of one that varies."""
    given = {"tiny": tiny_bundle, "flat": flat(tiny_bundle), "tiled": tiled_bundle, "edged": edged, "shaped": shaped}
    bundle = given[name]
    it = load_device_material(bundle, (2, 3) if name == "tiled" else ORIGIN)
    assert (it.layout.nodes is not None) == (name == "shaped")
    monkeypatch.setattr(baked_density, "TOGETHER", 40)  # lines of which a part is left over
    texture, xi = it.layout.sizes[0], on_columns(it, columns)
    for varying in (False, True):
        shape = grid_shape(texture, varying, (1 + varying) * columns**2 * texture[0] * texture[1] * K)
        assert shape[-3:] == (columns * texture[0], columns * texture[1], K)
        numbers = bake(it, (None if varying else 0.3,), shape)
        for value in (0.0, 1.0) if varying else (0.3,):
            expected = by_network(it, xi, np.full(1, value, np.float32))
            found = by_grid(it, shape, numbers, xi, [value] if varying else [])
            np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-6)
        assert expected.std() > 0.05 * expected.mean()


@pytest.mark.parametrize("name", ["tiny", "edged"])
def test_between_them_it_is_linear(name, tiny_bundle, edged):
    """Along each axis, and in a parameter that varies; beyond a texture's edge, or the box's, as at it."""
    it = load_device_material({"tiny": tiny_bundle, "edged": edged}[name], ORIGIN)
    shape = grid_shape(it.layout.sizes[0], 1, 2**25)
    numbers, xi, steps = bake(it, (None,), shape), on_columns(it, 2), np.eye(3, dtype=np.float32)
    read = partial(by_grid, it, shape, numbers)
    ends = read(xi, [0.0])
    np.testing.assert_allclose(read(xi, [0.25]), 0.75 * ends + 0.25 * read(xi, [1.0]), rtol=1e-4)
    np.testing.assert_array_equal(read(xi, [-3.0]), ends)
    wide = 1 / (2 * it.layout.texel_density)
    for axis, width in enumerate((wide, wide, 1 / K)):
        there = read(xi + width * steps[axis], [0.0])
        middle = read(xi + width / 4 * steps[axis], [0.0])
        np.testing.assert_allclose(middle, 0.75 * ends + 0.25 * there, rtol=1e-3, atol=1e-3 * ends.max())
    far = xi + np.array([3.0, 0, 0], np.float32)
    if name == "edged":
        np.testing.assert_array_equal(read(xi + 100 * steps[0], [0.0]), read(far, [0.0]))
    else:
        np.testing.assert_allclose(read(far, [0.0]), ends, rtol=1e-3, atol=1e-3 * ends.max())
    np.testing.assert_array_equal(read(xi * [1, 1, 0], [0.0]), read(xi * [1, 1, 0] - 5 * steps[2], [0.0]))


def test_what_is_not_finite_stays_in_its_sample(tiny_bundle):
    """A ray that is nowhere makes no other one wrong, and reads inside the grid."""
    it = load_device_material(tiny_bundle)
    shape = grid_shape(it.layout.sizes[0], 0, 2**25)
    xi = on_columns(it, 2, 4)
    xi[1], xi[2, 0] = np.nan, np.inf
    found = by_grid(it, shape, bake(it, (0.3,), shape), xi)
    assert np.isfinite(found[[0, 3]]).all()


def test_a_grid_is_of_a_material_and_its_parameters(tiny_bundle, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    it, made = load_device_material(tiny_bundle), []
    monkeypatch.setattr(baked_density, "bake", lambda *a: made.append(a) or bake(*a))
    shape = grid_shape(it.layout.sizes[0], 0, 2**25)
    first = baked_density.baked_density(it, np.array([0.5], np.float32), (), shape)
    assert baked_density.baked_density(it, np.array([0.5], np.float32), (), shape) is first and len(made) == 1
    baked_density.baked_density(it, np.array([0.25], np.float32), (), shape)
    assert len(made) == 2
    assert load_device_material(tiny_bundle, (5, 7)).digest == it.digest
    arrays = tiny_bundle.arrays | {"sigma_scale": 2 * tiny_bundle.arrays["sigma_scale"]}
    other = load_device_material(replace(tiny_bundle, arrays=arrays))
    assert other.digest != it.digest and replace(it, material=other.material).digest == other.digest
    assert not replace(it, material=other.material).densities
