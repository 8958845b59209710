"""A fit recovers fog, an interrupted fit ends where the uninterrupted one does, and decoding less changes no ray's value."""

import json
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from data_gen.tiles import COLOURS
from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.io.exemplars import Exemplars, read_exemplars, write_exemplars
from mesoshell.train import run
from mesoshell.train.export import patch_bundle
from mesoshell.train.fit.feed import adapt, feed
from mesoshell.train.fit.holdout import score
from mesoshell.train.fit.patch_rays import FitData, Rays, gather_fit_data
from mesoshell.train.fit.result import conclude, fit_config, fit_data_for
from mesoshell.train.fit.slab_pixels import predict, residual
from mesoshell.train.fit.snapshot import exemplars, provenance
from mesoshell.train.fit.state import FitConfig, FitState, material_of, texture_of
from mesoshell.train.fit.step import start, step
from mesoshell.train.textures.state import TexturesConfig
from mesoshell.train.textures.state import adapt as adapt_textures
from mesoshell.typing import Scalar
from tests.helpers import fog
from tests.helpers.patch_images import of_patches, of_tiles

CONFIG = FitConfig(
    texels=4,
    channels=4,
    height_rows=4,
    octaves=1,
    trunk=(16,),
    head=(16,),
    batch=2,
    rays=64,
    candidates=16,
    decoded=1.0,
    kept=10**6,
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> FitData:
    folder = tmp_path_factory.mktemp("fog")
    unseen = fog.write(folder / "unseen", [(2.2, 1.9, 2.0)])
    return gather_fit_data([fog.write(folder / "train", fog.CAMERAS)], tests=[unseen])


def test_fog_is_recovered_in_views_not_seen(data: FitData, tmp_path: Path):
    config, seen = adapt(replace(CONFIG, steps=200), data)
    state = run.train(config, seen, tmp_path)
    where = data.samples[-1].file.parents[1]
    scores, pictures = score(config, seen, lambda k: material_of(state.common, state.own.feature[k]), where)
    assert scores.alpha > 35 and scores.foreground > 35
    assert pictures.shape == (1, fog.SIZE, fog.SIZE, 4)


@pytest.fixture(scope="module")
def patches(tmp_path_factory: pytest.TempPathFactory) -> FitData:
    """Three patches of the same fog."""
    return gather_fit_data([of_patches(tmp_path_factory.mktemp("many") / "set", [0, 0, 0, 1, 1, 1, 2, 2, 2])], held=1)


def test_any_seed_draws_rows(data: FitData):
    config, seen = adapt(replace(CONFIG, seed=-1), data)
    rows = feed(config, seen)(0)
    assert np.isfinite(rows.direction).all() and (rows.key != feed(replace(config, seed=1), seen)(0).key).any()


def test_what_shows_nothing_cannot_be_scored(data: FitData, tmp_path: Path):
    away = fog.write(tmp_path / "away", fog.CAMERAS[:1])
    pose = away.samples[0].camera_to_world @ np.diag([1.0, 1.0, -1.0, 1.0])
    away = replace(away, samples=(replace(away.samples[0], camera_to_world=pose),))
    shown = fog.write(tmp_path / "shown", fog.CAMERAS)
    with pytest.raises(InputError, match="away: has no held-out picture that shows its patch: nothing to score"):
        fit_data_for(CONFIG, [shown], [away])


@pytest.mark.parametrize("steps", [1, 1000, 2007, 2008, 10500])
def test_a_fit_takes_its_steps(steps: int):
    assert run.steps_of(FitConfig(steps=steps)) == steps


def test_a_step_moves_the_patches_that_it_shows_and_no_other(patches: FitData):
    config, seen = adapt(replace(CONFIG, group=2, steps=4, stand=0.0), patches)
    state, batch = start(config, seen, jax.random.key(0)), feed(config, seen)(3)
    new, _ = jax.jit(lambda s, b: step(config, s, b))(state, batch)
    moved = [k for k in range(3) if not np.array_equal(state.own.feature[k], new.own.feature[k])]
    assert moved == sorted(set(batch.patch.tolist())) and len(moved) == 2
    np.testing.assert_array_equal(new.own.adam.count, np.isin(np.arange(3), moved))


@pytest.fixture(scope="module")
def tiles(tmp_path_factory: pytest.TempPathFactory) -> FitData:
    """The 16 tiles of a torus, of the same fog."""
    return gather_fit_data([of_tiles(tmp_path_factory.mktemp("tiles") / "set", [*range(16), *range(16)])], held=1)


def test_a_tile_is_learned_where_it_lies_on_the_torus(tiles: FitData):
    """A row moves the texels of its tile, and those beyond its borders that it is interpolated from; nothing else."""
    config, seen = adapt(replace(CONFIG, batch=1, rays=256), tiles)
    state, batch = start(config, seen, jax.random.key(0)), feed(config, seen)(0)
    assert state.own.feature.shape == (1, 16, 16, 4) and config.layout.period == 4
    finest = batch._replace(patch=np.full_like(batch.patch, 6), radius=np.zeros_like(batch.radius))
    new, _ = jax.jit(lambda s, b: step(config, s, b))(state, finest)
    moved = np.abs(np.asarray(new.own.feature - state.own.feature)[0]).max(axis=2) > 0
    rows, columns = np.arange(3, 9), np.arange(7, 13)  # tile (2, 1): texels 8 to 11 along u, 4 to 7 along v
    assert moved[4:8, 8:12].all()
    inside = np.zeros_like(moved)
    inside[np.ix_(rows, columns)] = True
    assert not moved[~inside].any()


@pytest.mark.slow
def test_a_torus_of_fog_is_recovered(tiles: FitData, tmp_path: Path):
    config, seen = adapt(replace(CONFIG, steps=150), tiles)
    state = run.train(config, seen, tmp_path / "run")
    where = tiles.samples[0].file.parents[1]
    scores, _ = score(config, seen, lambda k: material_of(state.common, texture_of(config, state, k)), where)
    assert scores.alpha > 32 and scores.foreground > 32


def test_a_torus_is_a_material(tiles: FitData):
    config, seen = adapt(CONFIG, tiles)
    state = start(config, seen, jax.random.key(0))
    made = conclude(config, seen, state, [], []).made
    assert isinstance(made, Bundle) and made.tiles == tuple(map(tuple, COLOURS)) and made.texel_density == 4
    cut = exemplars(config, seen, state, {}).features
    assert cut.shape == (16, 4, 4, 4)
    np.testing.assert_array_equal(cut[6], state.own.feature[0, 4:8, 8:12])


@pytest.mark.slow
def test_tiles_on_one_device_two_and_pmap_agree():
    """Textures, decoder and occupancy after three steps; on both devices the same."""
    command = [sys.executable, "-m", "tests.helpers.tiles_step"]
    done = subprocess.run(command, cwd=Path(__file__).parents[3], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout.splitlines()[-1])
    assert len(said) == 8
    for name, value in said.items():
        assert value == 24 if name.endswith("images") else value < 1e-6, name


def test_tiles_on_their_way_are_no_patches_that_repeat(tiles: FitData, tmp_path: Path):
    config, seen = adapt(CONFIG, tiles)
    state = start(config, seen, jax.random.key(0))
    write_exemplars(tmp_path / "a.npz", exemplars(config, seen, state, provenance(config, seen, state)))
    found = read_exemplars(tmp_path / "a.npz")
    with pytest.raises(InputError, match=r"a.npz: holds corner tiles of an unfinished fit, not patches that repeat"):
        patch_bundle(found, 0)
    with pytest.raises(InputError, match="not patches that repeat"):
        adapt_textures(TexturesConfig(), found)


def test_the_decoder_stands_when_it_has_settled(patches: FitData):
    config, seen = adapt(replace(CONFIG, steps=10, settle=0.5), patches)
    learn, at = jax.jit(lambda s, b: step(config, s, b)), feed(config, seen)
    states = [start(config, seen, jax.random.key(0))]
    for i in range(7):
        states.append(learn(states[-1], at(i))[0])
    moves = [not same(a.common, b.common) for a, b in pairwise(states)]
    assert moves == [True] * 5 + [False] * 2
    assert not same(states[5].own.feature, states[6].own.feature)


def test_a_decoder_that_is_given_stays(patches: FitData, tiny_bundle: Bundle, tmp_path: Path):
    age = replace(tiny_bundle.parameters[0], name="age", range=(0.0, 10.0))
    write_bundle(tmp_path / "given.npz", replace(tiny_bundle, parameters=(age,)))
    config, seen = adapt(replace(CONFIG, given=str(tmp_path / "given.npz")), patches)
    assert (config.channels, config.trunk, config.head) == (4, (8, 8), (8,))
    state = start(config, seen, jax.random.key(0))
    new, _ = jax.jit(lambda s, b: step(config, s, b))(state, feed(config, seen)(0))
    assert same(state.common, new.common) and not same(state.own.feature, new.own.feature)
    np.testing.assert_array_equal(new.common.decoder.sigma.kernel, tiny_bundle.arrays["decoder/sigma/kernel"])
    write_bundle(tmp_path / "given.npz", tiny_bundle)
    with pytest.raises(InputError, match="its decoder takes dryness from 0 to 2; the data give age from 0 to 10"):
        adapt(replace(CONFIG, given=str(tmp_path / "given.npz")), patches)


@pytest.mark.slow
def test_an_interrupted_fit_goes_on(patches: FitData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    config, seen = adapt(replace(CONFIG, steps=12, group=2), patches)
    whole = run.train(config, seen, tmp_path / "whole")
    monkeypatch.setattr(run, "SAVE_EVERY", 0.0)
    monkeypatch.setattr(run, "LOG_EVERY", 5)

    def stop(row: dict) -> None:
        if row["kimg"] == 10 * config.batch / 1000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run.train(config, seen, tmp_path / "parts", show=stop)
    assert same(whole, run.train(config, seen, tmp_path / "parts"))
    kept = read_exemplars(next((tmp_path / "whole" / "snapshots").glob("*.npz")))
    np.testing.assert_array_equal(kept.features, np.asarray(whole.own.feature, np.float16))


def test_exemplars_are_read_as_they_were_written(patches: FitData, tmp_path: Path):
    config, seen = adapt(CONFIG, patches)
    state = start(config, seen, jax.random.key(0))
    written: Exemplars = exemplars(config, seen, state, provenance(config, seen, state))
    write_exemplars(tmp_path / "e.npz", written)
    found = read_exemplars(tmp_path / "e.npz")
    np.testing.assert_array_equal(found.features, written.features.astype(np.float16))
    assert (found.parameters, found.height_octaves) == (written.parameters, 1)
    assert found.provenance["datasets"][0]["recipe"] == found.recipe == "fog"
    for key, array in written.decoder.items():
        np.testing.assert_array_equal(found.decoder[key], array)


def same(a: Any, b: Any) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


#: By layout and budget.
predicted = jax.jit(predict, static_argnums=(0, 1))


def some(data: FitData) -> tuple[FitConfig, FitState, Rays]:
    """A row of rays whose filters are no wider than a cell: those that are wide are always decoded."""
    config, seen = adapt(replace(CONFIG, rays=128), data)
    row = jax.tree.map(lambda x: jnp.asarray(x[0]), feed(config, seen)(0))
    return config, start(config, seen, jax.random.key(0)), row._replace(radius=0.01 * row.radius)


def test_a_smaller_budget_leaves_rays_out_and_changes_none(data: FitData):
    config, state, row = some(data)
    material, jitter = material_of(state.common, state.own.feature[0]), jnp.full((128, config.candidates), 0.5)
    full, complete, _ = predicted(config.layout, 1.0, material, row, state.own.occupancy[0], jitter)
    assert bool(complete.all())
    half, kept, wanted = predicted(config.layout, 0.5, material, row, state.own.occupancy[0], jitter)
    assert 0 < int(kept.sum()) < 128 and float(wanted) == pytest.approx(2.0, rel=0.05)
    long = kept & (full[:, 3] > 0.3)  # no candidate of theirs is too short to matter
    np.testing.assert_allclose(half[long], full[long], rtol=1e-5, atol=1e-6)


def test_empty_cells_are_not_decoded(data: FitData):
    config, state, row = some(data)
    empty = state.own.occupancy[0].at[16:].set(0.0)  # the upper half
    material, jitter = material_of(state.common, state.own.feature[0]), jnp.full((128, config.candidates), 0.5)
    y, complete, wanted = predicted(config.layout, 0.99, material, row, empty, jitter)
    all_, _, _ = predicted(config.layout, 1.0, material, row, empty, jitter)
    assert 0.5 < float(wanted) < 1.5  # half of the candidates, over a budget of half of them
    assert (y[complete, 3] < all_[complete, 3] - 1e-3).mean() > 0.5


def test_the_best_answer_for_pixels_that_look_alike_is_their_mean():
    """Of radiance, not of x/(1+x), whose mean is 0.57 here in place of 1.05; small differences are those of y."""
    target = jnp.asarray([[tonemapped(x)] * 3 + [1.0] for x in (0.1, 2.0)], jnp.float32)

    def loss(x: Scalar) -> Scalar:
        y = jnp.broadcast_to(jnp.append(jnp.full(3, x / (1 + x)), 1.0), (2, 4))
        return jnp.mean(jnp.square(residual(y, target)))

    slopes = [float(jax.grad(loss)(jnp.asarray(x, jnp.float32))) for x in (1.04, 1.05, 1.06)]
    assert slopes[0] < -1e-4 < slopes[1] < 1e-4 < slopes[2]
    y = target + jnp.asarray([[1e-3, -1e-3, 0, 1e-3]] * 2, jnp.float32)
    np.testing.assert_allclose(residual(y, target), y - target, rtol=5e-3, atol=1e-6)


@pytest.mark.parametrize("target", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("predicted", [0.0, 0.5, 1.0])
def test_infinite_radiance_is_a_bounded_error(predicted: float, target: float):
    """y is 1 from 2e7 on in single precision: a firefly, or a prediction that diverged."""
    y, true = (jnp.full(4, v, jnp.float32) for v in (predicted, target))
    error, gradient = jax.value_and_grad(lambda y: jnp.sum(jnp.square(residual(y, true))))(y)
    assert np.isfinite(error) and np.isfinite(np.asarray(gradient)).all() and float(error) < 1e5


def tonemapped(x: float) -> float:
    return x / (1 + x)


def test_one_patch_of_many_is_a_material(patches: FitData, tmp_path: Path, capsys: pytest.CaptureFixture):
    config, seen = adapt(CONFIG, patches)
    state = start(config, seen, jax.random.key(0))
    write_exemplars(tmp_path / "e.npz", exemplars(config, seen, state, provenance(config, seen, state)))
    main(["export", str(tmp_path / "e.npz"), "--patch", "2", "--out", str(tmp_path / "m.npz")])
    found = read_bundle(tmp_path / "m.npz")
    np.testing.assert_array_equal(found.arrays["features/0"], np.asarray(state.own.feature[2], np.float16))
    assert found.wraps and found.provenance["patch"] == 2 and [p.name for p in found.parameters] == ["age"]
    with pytest.raises(SystemExit) as ended:
        main(["export", str(tmp_path / "e.npz"), "--out", str(tmp_path / "n.npz")])
    assert ended.value.code == 2
    assert "has 3 patches: say which, 0 to 2" in capsys.readouterr().err and not (tmp_path / "n.npz").exists()


@pytest.mark.parametrize(
    ("rays", "rows", "group"), [(7, 1, 4), (2048, 8, 4), (4096, 8, 4), (4608, 8, 4), (32768, 64, 32)]
)
def test_many_rays_have_more_rows_and_patches(rays: int, rows: int, group: int) -> None:
    """In eights, which devices can share."""
    config = fit_config(rays=rays)
    assert (config.batch, config.rays * config.batch, config.group) == (rows, rays, group)
