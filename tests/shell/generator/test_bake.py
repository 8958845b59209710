"""Baked textures: tiles are the whole, levels are means, bounds bound, and only what is needed is made."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.io.twin import Twin
from mesoshell.shell.generator.generator import synthesise
from mesoshell.shell.generator.model import generator_model, grown
from mesoshell.shell.generator.plan import halo_cost
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle, grow
from mesoshell.shell.geometry.chart import patches_of, texture_origin
from mesoshell.shell.material.field import Point, neural_field
from mesoshell.shell.material.loader import load_device_material
from mesoshell.texture import mip
from tests.helpers import growing, wearing

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("bake")

TEXELS = growing.TEXELS


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return growing.bundle()


@pytest.fixture(scope="module")
def field(bundle) -> Bundle:
    """5.3 × 4.6 patches: four tiles, three of them cut."""
    return bake_bundle(bundle, "it", (74, 85), TextureRequest(7, {"length": 1.5, "age": 4.0}))[0]


def test_tiles_are_the_whole(bundle, field) -> None:
    maker = generator_model(bundle, "it")
    g = grown(maker, 7, np.array([0.25], np.float32))
    corner = jnp.zeros(2, jnp.int32)
    whole = jax.jit(lambda t: synthesise(maker.config, maker.generator, maker.averages, g.w, g.phases, t, (74, 85)))(
        corner
    )
    found = field.arrays["features/0"]
    assert found.shape == (74, 85, 4) and found.dtype == np.float16
    np.testing.assert_allclose(found, whole.feature[0], rtol=2**-11, atol=1e-5)
    for i, level in enumerate(mip.build_open(whole.feature[0], 4)):
        np.testing.assert_allclose(field.arrays[f"features/{i}"], level, rtol=2**-10, atol=1e-5)


def test_a_bundle_from_before_a_field_was_added_means_what_it_did(bundle) -> None:
    """Fourier maps had one sinusoid a channel before there was a choice."""
    assert bundle.generator is not None
    older = {key: value for key, value in bundle.generator.items() if key not in ("waves", "drift")}
    found = generator_model(replace(bundle, generator=older), "it").config
    assert (found.waves, found.drift) == (1, 0.0)


def test_what_is_made_is_a_bundle_that_needs_no_generator(bundle, field, tmp_path) -> None:
    write_bundle(tmp_path / "a.npz", field)
    found = read_bundle(tmp_path / "a.npz")
    assert found.generator is None and not found.wraps and found.provenance["seed"] == 7
    assert [p.default for p in found.parameters] == [4.0, 1.5]
    assert found.arrays.keys() == field.arrays.keys()
    with pytest.raises(InputError, match=r"^a\.npz: holds one texture and no generator"):
        generator_model(found, "a.npz")


def test_what_was_distilled_from_one_texture_is_not_kept_with_another(bundle, monkeypatch) -> None:
    growing.without_grids(monkeypatch)
    twin = Twin(wearing.bundle(), (0.5,), (0.1, 0.1, 0.1), ((0.1, 0.01),))
    assert bake_bundle(replace(bundle, twin=twin), "it", (16, 16), TextureRequest(7))[0].twin is None


def test_extent_does_not_change_what_is_there(bundle, field, monkeypatch) -> None:
    growing.without_grids(monkeypatch)
    small = bake_bundle(bundle, "it", (20, 33), TextureRequest(7, {"length": 1.5}))[0]
    np.testing.assert_array_equal(small.arrays["features/0"], field.arrays["features/0"][:20, :33])


def test_other_seeds_and_other_geometry_are_other_textures(bundle, field, monkeypatch) -> None:
    growing.without_grids(monkeypatch)
    f = field.arrays["features/0"][:16, :16].astype(np.float32)
    for seed, values in ((8, {"length": 1.5}), (7, {"length": 3.0})):
        other = (
            bake_bundle(bundle, "it", (16, 16), TextureRequest(seed, values))[0].arrays["features/0"].astype(np.float32)
        )
        assert np.abs(other - f).max() > 0.05 * f.std()


def test_the_grid_bounds_what_no_probe_has_seen(field) -> None:
    found = load_device_material(field)
    density = neural_field(found.material, found.layout).density
    rng = np.random.default_rng(1)
    xi = rng.uniform(size=(20_000, 3)) * [85 / TEXELS, 74 / TEXELS, 1]
    zero, age = jnp.zeros(len(xi)), jnp.asarray(rng.uniform(size=(len(xi), 1)), jnp.float32)
    point = Point(jnp.asarray(xi, jnp.float32), zero, zero, age)
    sigma = jax.jit(jax.vmap(lambda p: density(p)[0]))(point)
    grid = field.arrays["grid/0"]
    assert grid.shape == (16, 37, 43)
    cell = (xi[:, ::-1] * [16, 8, 8]).astype(int)
    h, v, u = np.minimum(cell, np.array(grid.shape) - 1).T
    assert np.mean(np.asarray(sigma) > grid[h, v, u]) < 1e-3
    assert field.provenance.get("excess_share", 0) < 1e-3


def test_only_needed_patches_are_made(bundle, field) -> None:
    needed = np.zeros((5, 6), bool)
    needed[4, 5] = True
    some = bake_bundle(bundle, "it", (74, 85), TextureRequest(7, {"length": 1.5}), needed)[0]
    np.testing.assert_array_equal(some.arrays["features/0"][64:, 64:], field.arrays["features/0"][64:, 64:])
    np.testing.assert_array_equal(some.arrays["grid/0"][:, 36:, 36:], field.arrays["grid/0"][:, 36:, 36:])
    assert not some.arrays["features/0"][:64].any() and not some.arrays["grid/1"][:, :32].any()


def test_a_coarser_texture_is_the_upper_levels_of_the_fine_one(bundle, field) -> None:
    coarse = bake_bundle(bundle, "it", (74, 85), TextureRequest(7, {"length": 1.5, "age": 4.0}, coarser=2))[0]
    assert coarse.texel_density == TEXELS / 4
    same = {key: array for key, array in field.arrays.items() if key.startswith("height")}
    same |= {f"features/{i}": field.arrays[f"features/{i + 2}"] for i in range(3)}
    assert {k for k in coarse.arrays if k.startswith(("features", "height"))} == same.keys()
    for key, array in same.items():
        np.testing.assert_array_equal(coarse.arrays[key], array)
    for i in range(3):  # found from other probes
        ours, finer = (x.astype(np.float64) for x in (coarse.arrays[f"grid/{i}"], field.arrays[f"grid/{i + 2}"]))
        np.testing.assert_allclose(ours.mean(), finer.mean(), rtol=0.1)


def test_patches_of_a_chart_that_lies_anywhere() -> None:
    uv = np.array([[[-3.2, 7.1], [-2.9, 7.2], [-3.1, 7.9]], [[2.6, 7.4], [2.9, 7.4], [2.7, 7.3]]])
    origin, needed = patches_of(uv)
    assert origin == (-4, 6)
    expected = np.zeros((3, 8), bool)
    expected[:, 0:2] = True  # u from −3.7 to −2.4, v from 6.6 to 8.4
    expected[:2, 6:] = True  # u from 2.1 to 3.4, v from 6.8 to 7.9
    np.testing.assert_array_equal(needed, expected)


@pytest.mark.parametrize(
    ("low", "size", "origin"),
    [
        ((0.0, 0.0), (3.0, 3.0), (0, 0)),  # baked for the square
        ((0.0, 0.0), (5.0, 5.0), (-1, -1)),  # grown for it, with what lookups from afar reach
        ((-1e-5, 2.0), (3.0, 3.0), (0, 2)),
        ((-0.2, 0.0), (5.0, 4.0), (-1, -1)),
        ((0.0, 0.0), (2.0, 9.0), (-1, 0)),  # smaller along v alone
    ],
)
def test_where_a_given_texture_begins(low, size, origin) -> None:
    """Of a square of 3 × 3 patches."""
    corner = np.array([[0, 0], [3, 0], [3, 3], [0, 0], [3, 3], [0, 3]], np.float64).reshape(2, 3, 2)
    assert texture_origin(corner + np.array(low), size) == origin


def test_a_grown_surface_reads_its_own_texture(bundle) -> None:
    """At a chart far from the origin, the field is that of the texture at the chart's own coordinates."""
    uv = np.array([[[100.6, -40.4], [101.4, -40.4], [100.6, -39.6]]])
    made, origin = grow(bundle, "it", uv, TextureRequest(7, {"length": 1.5}))
    assert origin == (100, -41) and made.arrays["features/0"].shape == (32, 32, 4)
    far, near = load_device_material(made, origin), load_device_material(made)
    at = jnp.array([100.75, -40.25, 0.5])
    zero = jnp.zeros(())

    def sigma(r, xi):
        return neural_field(r.material, r.layout).density(Point(xi, zero, zero, jnp.zeros(1)))[0]

    np.testing.assert_allclose(sigma(far, at), sigma(near, at - jnp.array([100.0, -41.0, 0.0])), rtol=1e-4)
    with pytest.raises(InputError, match="scale: the mesh would carry 800002 × 800002 patches"):
        grow(bundle, "it", uv * 1e6, TextureRequest(7))


def test_halo_costs_less_the_larger_the_tile() -> None:
    config = generator_model(growing.bundle(), "it").config
    found = [halo_cost(config, n * TEXELS) for n in (1, 2, 4, 64)]
    assert found == sorted(found, reverse=True) and 1 < found[-1] < 1.2


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"texels": 32}, "has shape"),
        ({"channel_max": 8}, "array generator/mix has shape (4, 4); expected (8, 8)"),
        ({"colour": 1}, "generator is not a configuration"),
        ({"layers": 3}, "generator is not a configuration: layers must be at least 4, not 3"),
        ({"layers": 27}, "generator is not a configuration: layers must be at most 26, not 27"),
        ({"betas": 0}, "has shape"),
    ],
)
def test_a_generator_that_does_not_fit_its_weights_is_refused(bundle, change, fault) -> None:
    wrong = replace(bundle, generator={**bundle.generator, **change})
    with pytest.raises(InputError) as caught:
        generator_model(wrong, "it")
    assert fault in str(caught.value) and "\n" not in str(caught.value)


def test_a_mean_square_of_nothing_is_refused(bundle) -> None:
    arrays = bundle.arrays | {"generator/magnitude/2": np.zeros((), np.float32)}
    with pytest.raises(InputError, match=r"^it: array generator/magnitude/2 is 0\.0; a mean square must be above 0"):
        generator_model(replace(bundle, arrays=arrays), "it")
