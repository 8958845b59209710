"""A corrected material shows from afar the mean of what near views show; near views stay bit for bit, and bounds hold."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.shell.generator.texture_synthesis import TextureRequest, baked
from mesoshell.shell.material.density_bounds import MARGIN
from mesoshell.shell.material.field import Point, inputs, neural_field
from mesoshell.shell.material.loader import ready
from mesoshell.train import prefilter
from mesoshell.train.prefilter import prefiltered
from tests.helpers import growing

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
    return prefiltered(tiny_bundle, "tiny", steps=60)


def looked_up(bundle: Bundle, radius: float, h: float = 0.6) -> np.ndarray:
    """The network's inputs at places of one height."""
    made, rng = ready(bundle), np.random.default_rng(0)
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


def test_what_is_near_stays_bit_for_bit(corrected, tiny_bundle) -> None:
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


def test_bounds_are_of_the_corrected_material(corrected) -> None:
    made = corrected[0]
    loaded, rng = ready(made), np.random.default_rng(1)
    field = neural_field(loaded.material, loaded.layout)
    for level in range(3):
        radius = jnp.float32(0 if level == 0 else 2**level / 8)
        xi = rng.random((4000, 3)).astype(np.float32)
        alpha = rng.random((4000, 1)).astype(np.float32)
        sigma = jax.vmap(lambda x, a, r=radius: field.density(Point(x, r, jnp.float32(0), a))[0])(xi, alpha)
        grid = made.arrays[f"grid/{level}"].astype(np.float32)
        cell = np.minimum((xi[:, ::-1] * grid.shape).astype(int), np.array(grid.shape) - 1)
        assert (np.asarray(sigma) > grid[tuple(cell.T)]).mean() < 0.01
        assert grid.max() < 1.2 * MARGIN * max(float(sigma.max()), 1e-3) * 1.5


def test_a_second_time_begins_anew(few, corrected) -> None:
    """A correction is of the material, not of one that is corrected already."""
    again, _ = prefiltered(corrected[0], "tiny", steps=60)
    np.testing.assert_array_equal(again.arrays["correction"], corrected[0].arrays["correction"])


def test_tiles_and_a_generator(few, tiled_bundle, tmp_path) -> None:
    tiles, gaps = prefiltered(tiled_bundle, "tiles", steps=3)
    assert len(gaps) == 4 and tiles.tiles == tiled_bundle.tiles
    made, _ = prefiltered(growing.bundle(), "grown", steps=3)
    assert not made.baked and made.arrays["correction"].shape[0] == 5
    write_bundle(tmp_path / "made.npz", made)
    again = read_bundle(tmp_path / "made.npz")
    shifted = replace(again, arrays=again.arrays | {"correction": np.full_like(made.arrays["correction"], 2)})
    for coarser in (0, 2):
        texture, _ = baked(again, "grown", (32, 32), TextureRequest(coarser=coarser))
        np.testing.assert_array_equal(texture.arrays["correction"], made.arrays["correction"][coarser:])
        other, _ = baked(shifted, "grown", (32, 32), TextureRequest(coarser=coarser))
        assert (other.arrays["grid/1"] != texture.arrays["grid/1"]).any(), "bounds are of what is corrected"


def test_faults(tiny_bundle) -> None:
    grown, _ = baked(growing.bundle(), "it", (32, 32), TextureRequest())
    with pytest.raises(InputError, match=r"^a lawn: is one texture with edges: correct the material"):
        prefiltered(grown, "a lawn")
    with pytest.raises(InputError, match="steps: must be at least 1"):
        prefiltered(tiny_bundle, "tiny", steps=0)
    with pytest.raises(InputError, match="seed"):
        prefiltered(tiny_bundle, "tiny", seed=2**32)
