"""A corrected material shows from afar the mean of what near views show; what is not filtered stays, and bounds hold."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.io.kept_textures import to_folder
from mesoshell.io.twin import Twin
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle
from mesoshell.shell.material.field import Point, inputs, neural_field
from mesoshell.shell.material.loader import load_device_material
from mesoshell.train import prefilter
from mesoshell.train.export import grids_of
from mesoshell.train.prefilter import fit_correction
from tests.helpers import growing, wearing

pytestmark = [pytest.mark.xdist_group("prefilter")]


@pytest.fixture(scope="module")
def few():
    """Fewer views, rays and samples than a user's."""
    sizes = {"VIEWS": 256, "HELD": 48, "MANY": 48, "MORE": 48, "SAMPLES": 32, "FEW": 24, "BATCH": 32, "TEXTURES": 1}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in sizes.items():
            patch.setattr(prefilter, name, value)
        yield


@pytest.fixture(scope="module")
def corrected(few, tiny_bundle) -> tuple[Bundle, list[prefilter.Gap]]:
    gaps: list[prefilter.Gap] = []
    return fit_correction(tiny_bundle, "tiny", steps=60, show=gaps.append), gaps


def looked_up(bundle: Bundle, radius: float, h: float = 0.6) -> np.ndarray:
    """The network's inputs at places of one height."""
    made, rng = load_device_material(bundle), np.random.default_rng(0)
    xi = jnp.asarray(np.append(rng.random((50, 2)), np.full((50, 1), h), axis=1), jnp.float32)
    one = lambda xi: inputs(made.material, made.layout, Point(xi, jnp.float32(radius), jnp.float32(0), jnp.ones(1)))  # noqa: E731
    return np.asarray(jax.jit(jax.vmap(one))(xi))


def test_the_mean_of_near_views_is_seen_from_afar(corrected) -> None:
    _, gaps = corrected
    assert [gap.level for gap in gaps] == [1, 2]
    far = gaps[-1]
    assert far.rms[0] > 0.1, "a network of averages is not the average of the network"
    assert far.rms[1] < 0.6 * far.rms[0]
    assert abs(far.light[1] - 1) < 0.06
    assert all(gap.rms[1] <= gap.rms[0] for gap in gaps)


def test_what_is_not_filtered_stays_bit_for_bit(corrected, tiny_bundle) -> None:
    made, _ = corrected
    assert not made.arrays["correction"][0].any()
    np.testing.assert_array_equal(looked_up(made, 0.0), looked_up(tiny_bundle, 0.0))
    same = [k for k in tiny_bundle.arrays if not k.startswith("grid/")]
    assert all(np.array_equal(made.arrays[k], tiny_bundle.arrays[k]) for k in same)


@pytest.mark.parametrize("h", [0.0, 0.3, 1.0])
def test_what_is_added_is_linear_between_levels_and_rows(corrected, tiny_bundle, h) -> None:
    """At level 1½ of a texture of 4 texels."""
    made, rows = corrected[0], prefilter.ROWS
    at = 2**1.5 / 8
    z = np.clip(h * rows - 0.5, 0, rows - 1)
    low, high = int(z), min(int(z) + 1, rows - 1)
    levels = made.arrays["correction"].astype(np.float64)[1:3].mean(axis=0)
    expected = levels[low] + (z - low) * (levels[high] - levels[low])
    added = looked_up(made, at, h) - looked_up(tiny_bundle, at, h)
    np.testing.assert_allclose(added[:, :4], np.broadcast_to(expected, (50, 4)), atol=2e-5)
    assert not added[:, 4:].any()


def test_bounds_are_of_the_corrected_material(tiny_bundle) -> None:
    """Of one whose σ is far above what it was."""
    added = np.zeros((3, 4, 4), np.float16)
    added[1:] = np.random.default_rng(0).normal(size=(2, 4, 4)) * 3
    made = replace(tiny_bundle, arrays=tiny_bundle.arrays | {"correction": added})
    loaded, rng = load_device_material(made), np.random.default_rng(1)
    field = neural_field(loaded.material, loaded.layout)
    bounds, excess = grids_of(made)
    for level in (1, 2):
        radius = 2**level / 8 * 2 ** -rng.random(4000)
        spread = radius * 2 ** rng.random(4000)
        xi, alpha = rng.random((4000, 3)).astype(np.float32), rng.random((4000, 1)).astype(np.float32)
        wide, none = jnp.asarray(radius, jnp.float32), jnp.zeros(4000, jnp.float32)
        points = Point(jnp.asarray(xi), wide, none, jnp.asarray(alpha), jnp.asarray(spread, jnp.float32))
        sigma = np.asarray(jax.jit(jax.vmap(lambda p: field.density(p)[0]))(points))
        above = {}
        for name, grids in (("old", tiny_bundle.arrays), ("new", bounds)):
            grid = grids[f"grid/{level - 1}"].astype(np.float32)
            cell = np.minimum((xi[:, ::-1] * grid.shape).astype(int), np.array(grid.shape) - 1)
            above[name] = (sigma > grid[tuple(cell.T)]).mean()
        assert above["new"] < 0.01 < 0.03 < above["old"], above
    assert 0 <= excess["grid_excess_share"] < 0.01


def test_a_second_time_begins_anew(few, corrected) -> None:
    """A correction is of the material, not of one that is corrected already."""
    again = fit_correction(corrected[0], "tiny", steps=60)
    np.testing.assert_array_equal(again.arrays["correction"], corrected[0].arrays["correction"])


@pytest.mark.slow
def test_tiles_are_corrected(few, tiled_bundle) -> None:
    tiles = fit_correction(tiled_bundle, "tiles", steps=3)
    assert tiles.arrays["correction"].shape[0] == 5 and tiles.tiles == tiled_bundle.tiles


@pytest.mark.slow  # a texture of one, whose correction is laid into it, is below
def test_a_generator_is_corrected(few) -> None:
    made = fit_correction(growing.bundle(), "grown", steps=3)
    assert not made.baked and made.arrays["correction"].shape[0] == 5


@pytest.mark.slow
def test_a_grown_texture_has_the_correction_of_its_levels(tmp_path) -> None:
    """Read back from a file and from a folder; with fewer levels its finest is corrected too, filtered or not."""
    numbered = np.arange(5, dtype=np.float16)[:, None, None] * np.ones((5, 3, 4), np.float16)
    bundle = growing.bundle()
    write_bundle(tmp_path / "made.npz", replace(bundle, arrays=bundle.arrays | {"correction": numbered}))
    grown = read_bundle(tmp_path / "made.npz")
    for coarser in (0, 2):
        wanted = TextureRequest(coarser=coarser)
        texture, _ = bake_bundle(grown, "grown", (32, 32), wanted)
        plain, _ = bake_bundle(bundle, "grown", (32, 32), wanted)
        folder = tmp_path / f"folder{coarser}"
        folder.mkdir()
        to_folder(
            folder, lambda allocate, wanted=wanted: bake_bundle(grown, "grown", (32, 32), wanted, allocate=allocate)[0]
        )
        for found in (texture, read_bundle(folder)):
            np.testing.assert_array_equal(found.arrays["correction"], numbered[coarser:])
        assert texture.finest_corrected == (coarser == 2)
        assert (texture.arrays["grid/1"] != plain.arrays["grid/1"]).any(), "bounds are of what is corrected"
        kept, all_ = (
            load_device_material(texture).material_for(filtering=False),
            load_device_material(texture).material_for(filtering=True),
        )
        assert (kept.correction is None) == (coarser == 0)
        assert all_.correction is not None


def test_a_twin_and_a_texture_that_was_grown_are_left_out(few, tiny_bundle) -> None:
    """They are of the material as it was."""
    twin = Twin(wearing.bundle(), (0.5,), (0.0, 0.0, 0.0), ((0.25, 0.1), (2.0, 0.1)))
    assert fit_correction(replace(tiny_bundle, twin=twin), "tiny", steps=1).twin is None
    bundle = growing.bundle()
    texture, _ = bake_bundle(bundle, "grown", (32, 32), TextureRequest())
    both = replace(bundle, arrays=bundle.arrays | texture.arrays)
    assert both.baked and not fit_correction(both, "grown", steps=1).baked


def test_faults(tiny_bundle) -> None:
    grown, _ = bake_bundle(growing.bundle(), "it", (32, 32), TextureRequest())
    with pytest.raises(InputError, match=r"^a lawn: is one texture with edges: correct the material"):
        fit_correction(grown, "a lawn")
    with pytest.raises(InputError, match="steps: must be at least 1"):
        fit_correction(tiny_bundle, "tiny", steps=0)
    with pytest.raises(InputError, match="seed"):
        fit_correction(tiny_bundle, "tiny", seed=2**32)
