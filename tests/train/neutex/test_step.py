"""Learning an object: what a step sees and minimises, that phases move what they should, and that runs go on to the bit."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.measure.captured import CHART, VIEWS, score_views
from mesoshell.neutex.cameras import photo_rays, pixels
from mesoshell.neutex.capture import Capture, read_capture
from mesoshell.neutex.field import DENSITY, to_surface, to_texture
from mesoshell.neutex.store import read_neutex
from mesoshell.train.gan.presets import PAPER, SMALL, TINY
from mesoshell.train.method import ATLAS, method_of
from mesoshell.train.neutex import step as atlas
from mesoshell.train.neutex.ray_batches import Rays, held_out, recorded_capture
from mesoshell.train.neutex.step import (
    EACH,
    KEEP,
    NeuTexTrainConfig,
    adapt,
    feed,
    neutex_config,
    start,
    step,
    updated_grid,
)
from mesoshell.train.run import train
from mesoshell.train.run_config import keep_record, read_record, snapshots
from mesoshell.train.update import HERE
from tests.helpers import atlas_step, balls

ROOT = Path(__file__).parents[3]

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("train_atlas")

CONFIG = atlas_step.CONFIG


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Capture:
    return read_capture(balls.write_capture(tmp_path_factory.mktemp("captures") / "ball", views=16, size=32))


once = jax.jit(step, static_argnums=0)


def stepped(config: NeuTexTrainConfig, share: float, batch: Rays | None = None):
    """A step at this share of the run; the state before, and after."""
    begin = start(config, jax.random.key(0))._replace(images=jnp.asarray(round(share * config.kimg * 1000), jnp.int32))
    return begin, *once(config, begin, batch or jax.tree.map(jnp.asarray, atlas_step.rays()))


def moved(a, b) -> dict[str, bool]:
    """Which parts of the field did."""
    return {
        name: any(bool((x != y).any()) for x, y in zip(jax.tree.leaves(p), jax.tree.leaves(q), strict=True))
        for name, p, q in zip(a.field._fields, a.field, b.field, strict=True)
    }


def test_a_batch_is_two_thirds_of_the_object(capture) -> None:
    config, capture = adapt(replace(CONFIG, batch=96, side=32), capture)
    rows = feed(config, capture)(3)
    assert rows.o.shape == (96, 3) and (rows.mask >= 0.5).sum() == 64
    assert {x.dtype.name for x in rows} == {"float32", "int32"}
    np.testing.assert_allclose(np.linalg.norm(rows.d, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rows.u, axis=1), 1, atol=1e-6)
    assert (np.abs(rows.point) < 1).all()


def test_rows_are_pixels_of_the_views_that_are_learned_from(capture) -> None:
    """Each ray with its colour is found among the photographs, in the box's units, and never in one that is held out."""
    config, capture = adapt(replace(CONFIG, batch=48, side=32), capture)
    rows = feed(config, capture)(0)
    learned, tested = held_out(capture)
    assert tested == [7, 15]
    known = {}
    for v in learned:
        o, d = photo_rays(capture.photos[v], pixels(capture.photos[v]))
        for a, b, c in zip(capture.to_box(o), d, capture.rgb[v].reshape(-1, 3), strict=True):
            known[tuple(np.round(np.concatenate([a, b]), 4))] = c
    for o, d, rgb in zip(rows.o, rows.d, rows.rgb, strict=True):
        near = min(known, key=lambda k: np.abs(np.array(k) - np.concatenate([o, d])).max())
        assert np.abs(np.array(near) - np.concatenate([o, d])).max() < 1e-3
        np.testing.assert_allclose(known[near], rgb, atol=1e-6)


def test_a_step_depends_on_its_number_alone_and_hosts_share_it(capture) -> None:
    config, capture = adapt(replace(CONFIG, side=32), capture)
    whole = feed(config, capture)(5)
    parts = [feed(config, capture, host, 2)(5) for host in (0, 1)]
    for name in Rays._fields:
        joined = np.stack([getattr(p, name) for p in parts], axis=1).reshape(getattr(whole, name).shape)
        np.testing.assert_array_equal(joined, getattr(whole, name))
    assert not np.array_equal(whole.o, feed(config, capture)(6).o)
    with pytest.raises(InputError, match="16 rays do not come evenly from 3 hosts"):
        feed(config, capture, 0, 3)


def test_views_are_held_out_as_in_the_paper(capture) -> None:
    many = replace(capture, photos=capture.photos * 4)
    assert held_out(many)[1] == [6, 13, 30, 35] and len(held_out(many)[0]) == 60
    assert held_out(replace(capture, photos=capture.photos[:5]))[1] == []


def test_phases_move_what_they_should() -> None:
    """The cloud alone moves the inverse at first; later the cycle does; at the end only the texture learns."""
    begin, early, _ = stepped(CONFIG, 0.0)
    assert moved(begin, early) == dict.fromkeys(begin.field._fields, True)
    no_points = replace(CONFIG, cloud=False, cycle=0.0)
    begin, alone, _ = stepped(no_points, 0.0)
    assert not moved(begin, alone)["inverse"]
    begin, late, report = stepped(CONFIG, 0.6)
    assert moved(begin, late) == dict.fromkeys(begin.field._fields, True) and float(report.chamfer) == 0
    begin, last, _ = stepped(CONFIG, 0.9)
    assert moved(begin, last) == {"sigma": False, "texture": True, "view": True, "uv": False, "inverse": False}


@pytest.mark.slow  # the phases' test sees what moves when
def test_at_first_the_cloud_alone_guides() -> None:
    """However heavy the cycle's and the masks' losses are, they do not move anything before their time; later they do."""
    batch = jax.tree.map(jnp.asarray, atlas_step.rays())

    def after(share, **weights):
        return jax.tree.leaves(stepped(replace(CONFIG, **weights), share, batch)[1].field)

    for share, same in ((0.0, True), (0.6, False)):
        for weights in ({"cycle": 100.0}, {"mask": 100.0}):
            pairs = zip(after(share), after(share, **weights), strict=True)
            assert all(bool((a == b).all()) for a, b in pairs) == same
    pairs = zip(after(0.0, alone=False), after(0.0, alone=False, cycle=100.0), strict=True)
    assert not all(bool((a == b).all()) for a, b in pairs)


def test_steps_turn_normals_to_the_cameras() -> None:
    """What rays see from behind becomes less with its loss than without, from normals that point the way a camera looks."""
    field = replace(CONFIG.field, colour="reflectance", flash=1.0)
    batch = jax.tree.map(jnp.asarray, atlas_step.rays())
    seen = {}
    for weight in (0.0, 0.3):
        config = replace(CONFIG, field=field, cloud=False, finish=0.0, facing=weight, rate=1e-2, kimg=1.6)
        state = start(config, jax.random.key(0))
        last = state.field.sigma.last
        last = last._replace(bias=last.bias.at[1:].set(batch.d[0]))
        state = state._replace(field=state.field._replace(sigma=state.field.sigma._replace(last=last)))
        for _ in range(20):
            state, report = once(config, state, batch)
            seen.setdefault(weight, []).append(float(report.facing))
    assert seen[0.0][0] == seen[0.3][0] > 0.05
    assert seen[0.3][-1] < 0.9 * seen[0.0][-1]


def test_chamfer_is_the_mean_square_distance_both_ways() -> None:
    """Points that lie apart from the sphere that the inverse map begins as: by hand."""
    field = start(CONFIG, jax.random.key(0)).field
    field = field._replace(inverse=jax.tree.map(jnp.zeros_like, field.inverse))
    rows = jax.tree.map(jnp.asarray, atlas_step.rays())
    u = jnp.asarray([[1, 0, 0], [0, 1, 0], [0, 1, 0]], jnp.float32)
    point = jnp.asarray([[1.6, 0, 0], [0.6, 0, 0.5], [0.6, 0, 0]], jnp.float32)
    found = atlas._chamfer(field, rows._replace(u=u, point=point), HERE)
    # to (0.6, 0, 0): 1, 0.25, 0; from it 0, from (0, 0.6, 0) twice to (0.6, 0, 0): 0.72
    assert float(found) == pytest.approx(1.25 / 3 + 2 * 0.72 / 3, rel=1e-5)


def test_the_cycle_moves_the_maps_alone() -> None:
    """By what its weight adds to the gradient."""
    config = replace(CONFIG, cloud=False, mask=0.0, cycle=1.0)
    batch = jax.tree.map(jnp.asarray, atlas_step.rays())
    begin = start(config, jax.random.key(0))

    def slope(weight):
        made = replace(config, cycle=weight)
        return once(made, begin, batch)[0].adam.inner_states["network"].inner_state[0].mu  # type: ignore[attr-defined]

    with_, without = slope(1.0), slope(0.0)
    for name in ("sigma", "texture", "view"):
        for a, b in zip(jax.tree.leaves(getattr(with_, name)), jax.tree.leaves(getattr(without, name)), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-7)
    assert any(bool((x != 0).any()) for x in jax.tree.leaves(with_.inverse))


def test_one_drawn_sample_stands_for_all_of_a_rays() -> None:
    """The mean over many draws is the paper's sum, equation 12."""
    field = start(CONFIG, jax.random.key(2)).field
    o, d = jnp.array([0.3, 0.2, -2.0]), jnp.array([0.0, 0.0, 1.0])
    occupied = jnp.ones((32,) * 3, bool)
    none, zero = jnp.zeros(3), jnp.zeros(())
    drawn = jax.jit(
        jax.vmap(
            lambda n: atlas._ray(CONFIG, field, occupied, jax.random.key(0), Rays(o, d, none, zero, n, none, none))[1]
        )
    )(jnp.arange(4096))
    from mesoshell.neutex.march import march

    def whole(n):
        xi, _ = jax.random.split(jax.random.fold_in(jax.random.key(0), n))
        found = march(CONFIG.field, field, o, d, occupied, jax.random.uniform(xi, (CONFIG.samples,)))
        apart = jax.vmap(lambda y: jnp.sum((to_surface(field, to_texture(field, y)) - y) ** 2))(found.y)
        return found.w @ apart

    exact = jax.jit(jax.vmap(whole))(jnp.arange(4096))
    error = float(jnp.std(drawn - exact)) / 64
    assert abs(float(jnp.mean(drawn)) - float(jnp.mean(exact))) < 4 * error + 1e-6


def test_the_grid_asks_every_cell_in_turn_and_forgets() -> None:
    field = start(CONFIG, jax.random.key(0)).field
    field = jax.tree.map(jnp.zeros_like, field)
    grid, key = jnp.full((8, 8, 8), 100.0), jax.random.key(0)
    ask = jax.jit(partial(updated_grid, CONFIG))
    for i in range(EACH):
        before = grid
        grid = ask(field, grid, jnp.asarray(i), key)
        assert int((grid != before).sum()) == 512 // EACH
    np.testing.assert_allclose(grid, KEEP * 100, rtol=1e-6)
    for i in range(EACH * 60):
        grid = ask(field, grid, jnp.asarray(i), key)
    np.testing.assert_allclose(grid, DENSITY * np.log(2), rtol=1e-5)


@pytest.mark.slow
def test_one_device_eight_and_pmap_agree() -> None:
    """Losses, gradients and the grid to 1e-6 in float64, eight devices with two rows each, with and without the cloud."""
    done = subprocess.run([sys.executable, "-m", "tests.helpers.atlas_step"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout.splitlines()[-1])
    assert len(said) == 16
    for name, value in said.items():
        assert value == 16 if name.endswith("images") else value < 1e-6, name


def test_presets_grow() -> None:
    assert neutex_config(TINY).side < neutex_config(SMALL).side < neutex_config(PAPER).side
    paper = neutex_config(PAPER, "frequency")
    assert paper.samples == 256 and paper.field.sigma == (256,) * 8 and paper.field.uv == (128, 128)
    assert paper.field.inverse == (512, 512) and 600 <= paper.batch <= 800


@pytest.mark.slow
def test_a_run_is_resumed_to_the_bit_and_kept(capture, tmp_path) -> None:
    """Stopped by SIGTERM half way, it goes on to the same bits as one that was not."""
    config = replace(CONFIG, kimg=16 * 64 / 1000, snapshot_kimg=16 * 32 / 1000, side=16)
    whole = train(config, capture, tmp_path / "whole")

    def stop(row):
        if row["kimg"] == 16 * 32 / 1000:
            os.kill(os.getpid(), signal.SIGTERM)

    half = train(config, capture, tmp_path / "a", show=stop)
    assert 0 < int(half.images) < int(whole.images)
    on = train(config, capture, tmp_path / "a")
    for a, b in zip(jax.tree.leaves(on), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    read, about = read_record(tmp_path / "a")
    assert method_of(read) is ATLAS and read == adapt(config, capture)[0]
    assert len(recorded_capture(about, 16).photos) == 16
    images, path = snapshots(tmp_path / "a")[-1]
    kept = read_neutex(path)
    assert images == 1024 and kept.tested == (7, 15)
    np.testing.assert_allclose(kept.centre, capture.centre)
    assert (tmp_path / "a/report.html").exists() and list((tmp_path / "a/sheets").glob("*.png"))


def test_a_background_belongs_to_a_run(capture, tmp_path) -> None:
    config = replace(CONFIG, side=16)
    keep_record(config, replace(capture, background="white"), tmp_path)
    with pytest.raises(InputError, match=r"data.background is white, asked for black"):
        keep_record(config, replace(capture, background="black"), tmp_path)


def test_a_box_belongs_to_a_run(capture, tmp_path) -> None:
    """Masks that were mended move it, and networks with it."""
    config = replace(CONFIG, side=16)
    keep_record(config, capture, tmp_path)
    keep_record(config, replace(capture, half=capture.half * (1 + 1e-9)), tmp_path)
    with pytest.raises(InputError, match=r"data\.box is"):
        keep_record(config, replace(capture, half=capture.half * 1.01), tmp_path)


def test_the_unit_of_length_does_not_matter_to_a_flash(capture) -> None:
    """The same photographs in metres and in centimetres: E⊥ at one unit's distance has the unit's square in it, and what is
    learned is the same."""
    config = replace(CONFIG, field=replace(CONFIG.field, colour="reflectance"))
    photos = tuple(p._replace(to_world=p.to_world @ np.eye(4)) for p in capture.photos)
    for p in photos:
        p.to_world[:3, 3] *= 100
    large = replace(capture, photos=photos, centre=100 * capture.centre, half=100 * capture.half, flash=30e4)
    (a, one), (b, other) = (adapt(config, replace(c, points=None)) for c in (replace(capture, flash=30.0), large))
    assert a.field.flash == pytest.approx(b.field.flash)
    rows, again = feed(a, one)(2), feed(b, other)(2)
    np.testing.assert_allclose(rows.o, again.o, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(rows.d, again.d, atol=1e-6)


def test_reflectance_is_learned_from_a_flash(capture) -> None:
    """Without one it is refused; with one, E⊥ comes in the box's units, and a step moves all but the colours of views."""
    config = replace(CONFIG, field=replace(CONFIG.field, colour="reflectance"))
    with pytest.raises(InputError, match="says no `flash`"):
        adapt(config, capture)
    made, _ = adapt(config, replace(capture, flash=30.0))
    assert made.field.flash == pytest.approx(30 / capture.half**2)
    begin, after, report = stepped(replace(made, batch=16), 0.6)
    assert moved(begin, after) == {"sigma": True, "texture": True, "view": False, "uv": True, "inverse": True}
    assert all(bool(jnp.isfinite(x).all()) for x in jax.tree.leaves(after)) and not bool(report.bad.any())


def test_objects_that_shrink_to_nothing_are_refused(capture) -> None:
    thin = replace(capture, masks=tuple(np.full_like(m, 0.3) for m in capture.masks))
    with pytest.raises(InputError, match="at 16 pixels a side no pixel is half covered"):
        adapt(CONFIG, thin)


@pytest.mark.slow
def test_it_learns_a_painted_ball(capture, tmp_path, optimised) -> None:
    """Views that were held out are shown, and the surface lies once, and evenly, in its texture."""
    config = replace(neutex_config(TINY), batch=256, kimg=256 * 0.3)
    train(config, capture, tmp_path)
    config, capture = adapt(config, capture)
    scores = score_views(read_neutex(snapshots(tmp_path)[-1][1]), capture, config.samples)
    assert tuple(scores) == VIEWS + CHART
    assert scores["PSNR"].value > 22 and scores["SSIM"].value > 0.8
    assert scores["cycle error, % of the box"].value < 3 and scores["texture folded"].value < 0.02
    assert scores["texture distortion"].value < 0.6 and scores["texture used"].value > 0.6
