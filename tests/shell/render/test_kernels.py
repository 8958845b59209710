"""What is compiled, and what the economies of a render cost.

Oracles: the operations of the lowered program, counted, with an effect off and on; a full evaluation of the same samples; the
bounds that `Quality` states for its shortcuts.
"""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.io.corner_tiles import FACTORS
from mesoshell.render.quality import Quality
from mesoshell.render.sequence import draws_at
from mesoshell.render.tiles import RenderReport
from mesoshell.shell.render import kernels
from mesoshell.shell.render.kernels import Samples, StaticConfig
from mesoshell.shell.render.lighting import Tile
from mesoshell.shell.render.renderer import _Renderer, render
from mesoshell.shell.render.scene import Scene
from tests.helpers import scenes


def setting(scene: Scene, quality: Quality) -> tuple[_Renderer, tuple]:
    """A renderer, and its kernels' arguments for all camera rays of the scene."""
    renderer = _Renderer(scene, quality, scenes.effects(scene, quality), RenderReport())
    random = np.random.default_rng(1)
    d = np.array([0.2, 0.3, -1.0]) + random.uniform(-0.1, 0.1, (64, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = np.array([0.4, 0.3, 2.0]) + random.uniform(-0.2, 0.2, (64, 3))
    i = renderer.boundary.trace(o, d).intervals
    pieces, at = renderer.frames(i, o, d)
    return renderer, (
        renderer.candidates(i, pieces, at, 0.5),
        pieces,
        at,
        Tile(o, d, renderer.lighting.beams(draws_at(np.zeros((len(o), 2)), 0.0))),
    )


@pytest.fixture(scope="module")
def lowered(tiny_bundle):
    """A function from a program's settings to the number of operations in its lowered density kernel."""
    renderer, (_, pieces, at, _) = setting(scenes.slab(tiny_bundle), scenes.FULL)
    empty = Samples(*(jnp.zeros(4096, t) for t in (jnp.int32, jnp.float32, jnp.float32, jnp.float32)))
    base = replace(renderer.media.each[0].program, filtering=False, taps=1, exact=False, maps=())

    def count(**changes: object) -> int:
        program: StaticConfig = replace(base, **changes)  # type: ignore[arg-type]
        table = renderer.media.each[0].table._replace(maps=jnp.zeros((len(program.maps), 2, 2)))
        text = kernels.density.lower(program, table, pieces, at, empty, np.int32(0)).as_text()
        return len(re.findall(r"= (?:stablehlo|call)", text))

    return count


FEWER = [
    ({}, {"filtering": True}),
    ({"filtering": True}, {"filtering": True, "taps": 4}),
    ({}, {"maps": (0,)}),
    ({}, {"exact": True}),
]


@pytest.mark.parametrize(("off", "on"), FEWER)
def test_an_effect_that_is_off_is_not_compiled(lowered, off: dict, on: dict):
    assert lowered(**off) < lowered(**on)


def test_taps_without_filtering_change_nothing(lowered):
    assert lowered(taps=16) == lowered()


def test_only_corner_tiles_are_hashed(tiny_bundle, tiled_bundle):
    """The hash's factors stand in the program of a material that has tiles, and in no other."""
    empty, hashed = Samples(*(jnp.zeros(4096, t) for t in (jnp.int32, jnp.float32, jnp.float32, jnp.float32))), []
    for bundle in (tiny_bundle, tiled_bundle):
        renderer, (_, pieces, at, _) = setting(scenes.slab(bundle), scenes.FULL)
        text = kernels.density.lower(
            renderer.media.each[0].program, renderer.media.each[0].table, pieces, at, empty, np.int32(0)
        ).as_text()
        hashed.append([str(factor) in text for factor in FACTORS])
    assert hashed == [[False, False], [True, True]]


def test_the_same_effects_share_a_program(tiny_bundle):
    scene = scenes.slab(tiny_bundle)
    first, second = (
        setting(s, scenes.FULL)[0].media.each[0].program
        for s in (scene, replace(scene, alpha=np.array([0.9], np.float32)))
    )
    assert first == second and hash(first) == hash(second)


def test_waves_give_what_a_full_evaluation_gives(tiny_bundle):
    """Early stop, skipping and the weight's cut at 0: Σ τ and Σ w of each ray as from one call on all its samples."""
    renderer, (candidates, pieces, at, tile) = setting(scenes.slab(tiny_bundle), scenes.FULL)
    depth, shaded = renderer.march(candidates, pieces, at, tile)
    samples, ray, _ = candidates
    padded = Samples(*(np.pad(x, (0, -len(x) % 4096)) for x in samples))
    tau, _ = kernels.density(
        renderer.media.each[0].program, renderer.media.each[0].table, pieces, at, padded, np.int32(len(samples.row))
    )
    tau = np.asarray(tau, np.float64)[: len(samples.row)]
    true = np.bincount(ray, tau, len(tile.o))
    np.testing.assert_allclose(depth, true, rtol=1e-6)
    weight = np.bincount(shaded.ray, shaded.weight, len(tile.o))
    np.testing.assert_allclose(weight, -np.expm1(-true), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("opacity", [1.0, 0.3])
def test_light_of_drawn_samples_is_that_of_all_in_the_mean(tiny_bundle, opacity: float):
    """Over evenly spaced u, whose sum errs by less than a sample's light; of at most two samples an opacity of which as much is
    expected as there is, and whatever is expected."""
    scene = scenes.slab(tiny_bundle)
    renderer, (candidates, pieces, at, tile) = setting(scene, scenes.FULL)
    candidates = candidates._replace(opacity=np.full(len(candidates.ray), opacity))
    depth, shaded = renderer.march(candidates, pieces, at, tile)
    few, _ = setting(scene, replace(scenes.FULL, light_samples=2))
    count = 2 / opacity
    levels = (np.arange(32) + 0.5) / 32
    total = np.zeros((len(tile.o), 3))
    for u in levels:
        same, drawn = few.march(candidates, pieces, at, tile, np.full(len(tile.o), u))
        np.testing.assert_array_equal(same, depth)  # opacity knows nothing of it
        assert (np.bincount(drawn.ray, minlength=1) <= np.ceil(count)).all() and (drawn.weight >= 0.999 / count).all()
        np.add.at(total, drawn.ray, drawn.weight[:, None] * drawn.rho[:, 0])
    true = np.zeros_like(total)
    np.add.at(true, shaded.ray, shaded.weight[:, None] * shaded.rho[:, 0])
    assert few.report.counts["transport_queries"] <= len(levels) * np.ceil(count) * len(tile.o)
    np.testing.assert_allclose(total / len(levels), true, atol=2 * shaded.rho.max() / (count * len(levels)))


@pytest.mark.parametrize("limit", [0.5, 0.1])
def test_early_stop_misses_at_most_its_limit(tiny_bundle, limit: float):
    scene = scenes.slab(tiny_bundle)
    _, arguments = setting(scene, scenes.FULL)
    exact = setting(scene, scenes.FULL)[0].march(*arguments)[0]
    early = setting(scene, replace(scenes.FULL, early_stop=limit))[0].march(*arguments)[0]
    assert (early <= exact * (1 + 1e-6)).all()
    assert (early < exact - 1e-3).any()  # some rays did stop
    assert (np.exp(-early) - np.exp(-exact)).max() <= limit
    assert (np.exp(-early[early < exact - 1e-3]) <= limit).all()


@pytest.mark.parametrize("plan", [{}, {"spacing": "interval", "samples": 1}])  # of which a ray may get more than 1
@pytest.mark.parametrize("skip", [0.03, 0.9])
def test_skipping_misses_at_most_its_bound(tiny_bundle, skip: float, plan: dict):
    """A ray's optical depth falls short by `skip` at most; the bundle says how rarely the σ bound fails."""
    scene = scenes.slab(tiny_bundle)
    exact, economic = (
        renderer.march(*arguments)[0]
        for renderer, arguments in (setting(scene, replace(scenes.FULL, skip=s, **plan)) for s in (0.0, skip))
    )
    assert (exact - economic <= skip + 1e-5).all()
    assert (economic <= exact + 1e-5).all()


def test_the_bound_covers_density(tiny_bundle):
    renderer, ((samples, *_), pieces, at, _) = setting(scenes.slab(tiny_bundle), scenes.FULL)
    padded = Samples(*(np.pad(x, (0, -len(x) % 4096)) for x in samples))
    arguments = (
        renderer.media.each[0].program,
        renderer.media.each[0].table,
        pieces,
        at,
        padded,
        np.int32(len(samples.row)),
    )
    bound, (tau, _) = kernels.depth_bounds(*arguments), kernels.density(*arguments)
    assert (np.asarray(tau) <= np.asarray(bound) * (1 + 1e-3)).mean() > 0.999


def test_exact_coordinates_are_the_interpolated_ones_in_a_straight_slab(tiny_bundle):
    scene = scenes.slab(tiny_bundle)
    _, arguments = setting(scene, scenes.FULL)
    plain = setting(scene, scenes.FULL)[0].march(*arguments)[0]
    exact = setting(scene, replace(scenes.FULL, coordinates="exact"))[0].march(*arguments)[0]
    np.testing.assert_allclose(exact, plain, rtol=1e-3, atol=1e-4)


def test_a_constant_map_is_the_number_itself(tiny_bundle):
    scene = scenes.slab(tiny_bundle)
    mapped = replace(scene, alpha=np.array([0.0], np.float32), maps={"dryness": np.full((3, 5), 0.5, np.float32)})
    pictures = [render(s, scenes.FULL, scenes.effects(s, scenes.FULL))[0] for s in (scene, mapped)]
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=1e-5, atol=1e-6)


def test_a_map_lies_on_the_slab_as_an_image_does(tiny_bundle):
    """Row 0 of the image is v = 1, column 0 is u = 0: each quarter of the slab is what its pixel's number gives alone."""
    scene = scenes.slab(tiny_bundle)
    values = np.array([[0.0, 1.0], [0.3, 0.6]], np.float32)
    xi = np.array([[0.25, 0.75, 0.5], [0.75, 0.75, 0.5], [0.25, 0.25, 0.5], [0.75, 0.25, 0.5]], np.float32)
    program = replace(setting(scene, scenes.FULL)[0].media.each[0].program, maps=(0,))
    table = setting(scene, scenes.FULL)[0].media.each[0].table._replace(maps=jnp.asarray(values[None]))
    found = [float(kernels._alpha(program, table, jnp.asarray(x))[0]) for x in xi]
    np.testing.assert_array_equal(np.array(found, np.float32), values.ravel())
