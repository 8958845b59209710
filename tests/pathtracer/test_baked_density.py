"""σ from a grid is the network's where the grid has a column, linear between, and as periodic as the texture."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.io import density_grid
from mesoshell.io.bundle import Bundle
from mesoshell.io.density_grid import K
from mesoshell.pathtracer import baked_density, load_dict
from mesoshell.pathtracer.baked_density import BakedDensity
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.media import Media, Medium, common_alpha
from mesoshell.pathtracer.samples import Sample
from mesoshell.render.effects import MAX_BAKED
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle
from mesoshell.shell.material.baked_density import bake
from mesoshell.shell.material.loader import load_device_material
from tests.helpers import growing
from tests.helpers.path_traced import QUALITY, rough, scene, shell

ORIGIN = (-2, 3)


@pytest.fixture(scope="module")
def edged() -> Bundle:
    """A texture with edges, of 3 × 2 patches."""
    return rough(bake_bundle(growing.bundle(), "it", (32, 48), TextureRequest(7))[0])


def by_network(material: Material, xi: np.ndarray, alpha: list[float]) -> np.ndarray:
    z = mi.Float(0)
    sample = Sample(mi.UInt32(0), z, mi.Vector3f(xi), z, z, z, mi.Vector2f(0))
    return np.array(material.density_of(material.inputs(sample, [mi.Float(a) for a in alpha], 0))[0])


def by_grid(grid: BakedDensity, xi: np.ndarray, alpha: list[float]) -> np.ndarray:
    return np.array(grid.at(mi.Vector3f(xi), [mi.Float(a) + dr.zeros(mi.Float, xi.shape[1]) for a in alpha]))


def on_columns(material: Material, columns: int, count: int = 500) -> np.ndarray:
    """Points of the grid within the texture, (3, count)."""
    rng = np.random.default_rng(0)
    height, width = material.plane.shapes[0][:2]
    i, j, k = (rng.integers(0, n, count) for n in (columns * width, columns * height, K))
    place = [(x + 0.5) / (columns * material.density) for x in (i, j)]
    if not material.wraps:
        place = [x + begin for x, begin in zip(place, ORIGIN, strict=True)]
    return np.stack([*place, (k + 0.5) / K]).astype(np.float32)


@pytest.mark.parametrize("name", ["tiny", "edged"])
@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("given", [0.3, None])
def test_a_grid_holds_what_the_network_says(name, columns, given, edged, tiny_bundle, monkeypatch) -> None:
    """At its own points, to half precision; of one value of a parameter, or at both ends of one that varies."""
    bundle = {"tiny": tiny_bundle, "edged": edged}[name]
    material = Material(bundle, ORIGIN)
    texture = material.plane.shapes[0]
    monkeypatch.setattr(baked_density, "CHUNK", 1000)  # several, and a part of one
    alpha: list[float | None] = [given] * len(material.names)
    grid = BakedDensity(material, alpha, 2 * columns**2 * texture[0] * texture[1] * K)
    assert grid.shape[-3:] == (columns * texture[0], columns * texture[1], K)
    xi = on_columns(material, columns)
    for value in (0.0, 1.0) if given is None else (given,):
        expected = by_network(material, xi, [value] * len(alpha))
        np.testing.assert_allclose(by_grid(grid, xi, [value] * len(alpha)), expected, rtol=2e-3, atol=1e-6)
    assert expected.std() > 0.05 * expected.mean()


def test_between_them_it_is_linear(tiny_bundle) -> None:
    """Along each axis, and in a parameter that varies."""
    material = Material(tiny_bundle)
    grid = BakedDensity(material, [None], MAX_BAKED)
    xi, steps = on_columns(material, 2), np.eye(3, dtype=np.float32)
    xi[2] = np.minimum(xi[2], 1 - 1.5 / K)
    ends = by_grid(grid, xi, [0.0])
    np.testing.assert_allclose(by_grid(grid, xi, [0.25]), 0.75 * ends + 0.25 * by_grid(grid, xi, [1.0]), rtol=1e-4)
    np.testing.assert_array_equal(by_grid(grid, xi, [-3.0]), ends)
    for axis, width in enumerate((1 / (2 * material.density), 1 / (2 * material.density), 1 / K)):
        there = by_grid(grid, xi + width * steps[axis][:, None], [0.0])
        middle = by_grid(grid, xi + width / 4 * steps[axis][:, None], [0.0])
        np.testing.assert_allclose(middle, 0.75 * ends + 0.25 * there, rtol=1e-3, atol=1e-3 * ends.max())


@pytest.mark.parametrize("name", ["tiny", "tiled"])
def test_a_plane_is_laid_as_the_network_sees_it(name, tiny_bundle, tiled_bundle) -> None:
    """By repetition, or by corner tiles: at columns anywhere, of tiles those a texel from a border."""
    material = Material({"tiny": tiny_bundle, "tiled": tiled_bundle}[name])
    grid, rng = BakedDensity(material, [0.5], MAX_BAKED), np.random.default_rng(1)
    columns = int(2 * material.density)
    column = rng.integers(2, columns - 2, (2, 2000)) if name == "tiled" else rng.integers(0, columns, (2, 2000))
    place = rng.integers(-40, 40, (2, 2000)) + (column + 0.5) / columns
    xi = np.stack([*place, (rng.integers(0, K, 2000) + 0.5) / K]).astype(np.float32)
    expected = by_network(material, xi, [0.5])
    np.testing.assert_allclose(by_grid(grid, xi, [0.5]), expected, rtol=3e-3, atol=1e-3)


def test_a_density_beyond_half_precision_is_its_largest(tiny_bundle) -> None:
    arrays = tiny_bundle.arrays | {"sigma_scale": tiny_bundle.arrays["sigma_scale"] * np.float32(1e9)}
    grid = BakedDensity(Material(replace(tiny_bundle, arrays=arrays)), [0.5], MAX_BAKED)
    assert np.isfinite(np.array(grid.numbers)).all() and np.array(grid.numbers).max() == np.finfo(np.float16).max


def test_both_engines_bake_the_same(tiny_bundle, edged) -> None:
    for bundle, alpha in ((tiny_bundle, None), (edged, 0.7)):
        grid = BakedDensity(Material(bundle), [alpha], MAX_BAKED)
        marched = bake(load_device_material(bundle), (alpha,), grid.shape)
        np.testing.assert_allclose(np.array(grid.numbers, np.float32), marched, rtol=2e-3, atol=1e-6)


def test_a_parameter_varies_if_shells_or_a_texture_differ(tiny_bundle) -> None:
    one, other = Material(tiny_bundle), Material(tiny_bundle)
    media = [Medium(one, (0.5,)), Medium(other, (0.1,)), Medium(one, (0.5,))]
    assert common_alpha(media, one) == [0.5] and common_alpha(media, other) == [0.1]
    assert common_alpha([*media, Medium(one, (0.25,))], one) == [None]
    texture: Any = mi.load_dict({"type": "bitmap", "bitmap": mi.Bitmap(np.zeros((2, 2, 1), np.float32)), "raw": True})
    assert common_alpha([Medium(one, (texture,))], one) == [None]


def test_pictures_have_the_same_mean(materials) -> None:
    """As with the network, unfiltered, within their noise; the network is asked only where light is scattered."""
    ways, queries = {}, {}
    for density in ("baked", "network"):
        quality = QUALITY.with_changes(density=density, filtering=False, samples=64)
        made: Any = load_dict(scene(shell(materials, "rough"), light={"type": "constant"}), quality)
        context = made.integrator().context
        assert context.effects.baked_density.on == (density == "baked") and not context.media.baked
        assert not context.effects.filtering.on
        ways[density] = np.stack([np.array(mi.render(made, spp=64, seed=mi.UInt32(k))) for k in range(8)])
        queries[density] = context.queries
    assert 0 < queries["baked"] < 0.5 * queries["network"]
    baked, network = (x[..., :3].mean(axis=(1, 2, 3)) for x in ways.values())
    assert abs(baked.mean() - network.mean()) < 4 * np.sqrt((baked.var() + network.var()) / 7) + 0.01 * network.mean()


def test_a_grid_is_made_once(tiny_bundle, monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    """Of the same material and parameter; another one's is another. What is damaged is made anew."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(density_grid, "MIN_KEPT", 1)
    made = []
    network = BakedDensity._by_network
    monkeypatch.setattr(BakedDensity, "_by_network", lambda *a: made.append(a) or network(*a))
    first = BakedDensity(Material(tiny_bundle), [0.5], MAX_BAKED)
    again = BakedDensity(Material(tiny_bundle, (5, 7)), [0.5], MAX_BAKED)
    assert len(made) == 1
    np.testing.assert_array_equal(np.array(first.numbers), np.array(again.numbers))
    BakedDensity(Material(tiny_bundle), [0.25], MAX_BAKED)
    other = tiny_bundle.arrays | {"sigma_scale": np.float32(2) * tiny_bundle.arrays["sigma_scale"]}
    BakedDensity(Material(replace(tiny_bundle, arrays=other)), [0.5], MAX_BAKED)
    assert len(made) == 3
    for entry in (tmp_path / "mesoshell" / "densities").iterdir():
        entry.write_bytes(entry.read_bytes()[:-100])
    BakedDensity(Material(tiny_bundle), [0.5], MAX_BAKED)
    assert len(made) == 4


def test_shells_of_several_materials_have_each_their_grid(tiny_bundle, edged) -> None:
    """And each its own number of a parameter; a material of two numbers is linear between 0 and 1."""
    one, other = Material(tiny_bundle), Material(edged, ORIGIN)
    shells = SimpleNamespace(shell=mi.UInt32([0, 1, 2]))
    media = Media(shells, [Medium(one, (0.25,)), Medium(other, (0.5,)), Medium(one, (1.0,))])
    media.bake()
    xi = on_columns(other, 2)
    prism = mi.UInt32(np.arange(xi.shape[1]) % 3)
    z = mi.Float(0)
    found = np.array(media.sigma(Sample(prism, z, mi.Vector3f(xi), z, z, z, mi.Vector2f(0)), 0, True))
    for k, (material, alpha) in enumerate(((one, 0.25), (other, 0.5), (one, 1.0))):
        mine = slice(k, None, 3)
        np.testing.assert_allclose(found[mine], by_grid(media.baked[material], xi, [alpha])[mine], rtol=1e-5)
    assert media.baked[one].varying == [0] and media.baked[other].varying == []
