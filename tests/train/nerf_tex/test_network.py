"""The parametric network: what its loss says, that it learns fog, sees all that it should, and is the same on any devices."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.io.pack import pack_dataset
from mesoshell.shell.material.field import Point
from mesoshell.train.gan.curriculum import renders, views_of
from mesoshell.train.gan.generate import ImageBatch
from mesoshell.train.gan.presets import TINY
from mesoshell.train.losses import EPSILON, smape, transmittance_loss
from mesoshell.train.method import NERF_TEX, method_of
from mesoshell.train.nerf_tex.network import NerfTexConfig, nerf_tex_config, paint, redrawn, see, start, step
from mesoshell.train.nerf_tex.seeds import SEED, with_seeds
from mesoshell.train.nerf_tex.seeds import adapt as adapt_nerf_tex
from mesoshell.train.nerf_tex.snapshot import load_predictor, pictures, save
from mesoshell.train.run import train
from mesoshell.train.run_config import keep_record, read_record
from mesoshell.train.update import HERE
from tests.helpers import fog, parametric_step

ROOT = Path(__file__).parents[3]

CONFIG = parametric_step.CONFIG


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Dataset:
    """Fog seen from eight distances, packed at 8²."""
    folder = tmp_path_factory.mktemp("data")
    fog.write(folder / "fog", [(0.6, 0.3, 1.6 + 0.2 * k) for k in range(8)], size=8)
    pack_dataset(read_dataset(folder / "fog"), folder / "packed")
    return read_dataset(folder / "packed")


@pytest.fixture(scope="module")
def batch() -> ImageBatch:
    return jax.tree.map(
        lambda x: jnp.asarray(x) if x.dtype == np.uint32 else jnp.asarray(x, jnp.float32), parametric_step.batch()
    )


def test_the_losses_are_what_they_say() -> None:
    a = np.array([0.0, 1.0, 3.0, 0.0], np.float32)
    b = np.array([0.0, 1.0, 1.0, 2.0], np.float32)
    ratio = np.mean([0, 0, 2 / (4 + EPSILON), 2 / (2 + EPSILON)])
    picture = [jnp.broadcast_to(x[:, None, None, None], (4, 2, 2, 3)) for x in (a, b)]
    np.testing.assert_allclose(smape(*picture), ratio, rtol=1e-6)
    np.testing.assert_allclose(smape(*picture[::-1]), ratio, rtol=1e-6)
    np.testing.assert_allclose(transmittance_loss(*(x[..., 0] for x in picture)), (4 + 4) / 4, rtol=1e-6)


@pytest.mark.parametrize("a", [0.0, 1e-30, 1e-6, EPSILON, 1.0, 1e6, 1e30])
@pytest.mark.parametrize("b", [0.0, 1e-6, 1.0, 65504.0])
def test_gradients_are_finite_and_bounded_at_black(a: float, b: float) -> None:
    """SMAPE lies in [0, 1]; its slope is at most 1/ε, 0 where a is b, black or not, and toward b elsewhere."""
    value, slope = jax.value_and_grad(lambda x: smape(jnp.full((1, 1, 1, 3), x), jnp.full((1, 1, 1, 3), b)))(
        jnp.float32(a)
    )
    assert 0 <= value <= 1 and jnp.isfinite(slope) and abs(slope) <= 1.0001 / EPSILON
    toward = slope * np.sign(a - b)
    assert slope == 0 if a == b else toward > (0 if a <= 1 else -1e-9)


def test_nothing_is_lost_where_the_picture_is_the_render(batch) -> None:
    """The loss compares each picture with its own camera's, light's and parameters' render, and with nothing else."""
    state, run = start(CONFIG, jax.random.key(0)), jax.jit(lambda s, b: step(CONFIG, s, b))
    made = jax.jit(lambda d, b: paint(CONFIG, d, b, HERE.each))(state.decoder, batch)
    _, report = run(state, batch._replace(image=made))
    assert report.radiance < 1e-6 and report.transmittance < 1e-12 and not report.bad.any()
    _, mixed = run(state, batch._replace(image=made[::-1]))
    assert mixed.radiance > 1e-3 and mixed.transmittance > 1e-5


def test_the_gradient_is_the_losss_slope() -> None:
    """Adam's first moment after one step is a tenth of the gradient: against differences in float64, along a direction."""
    with jax.enable_x64(True):
        begin = start(CONFIG, jax.random.key(0))
        exact = jax.tree.map(lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x, begin)
        shown = jax.tree.map(jnp.asarray, parametric_step.batch())
        direction = jax.tree.map(lambda x: jnp.cos(jnp.arange(x.size, dtype=x.dtype)).reshape(x.shape), exact.decoder)
        run = jax.jit(lambda s, b: step(CONFIG, s, b))

        def loss(t: float) -> float:
            moved = jax.tree.map(lambda x, d: x + t * d, exact.decoder, direction)
            _, report = run(exact._replace(decoder=moved), shown)
            return float(report.radiance + report.transmittance)

        moment = run(exact, shown)[0].adam[0].mu
        slope = 10 * sum(float(jnp.sum(m * d)) for m, d in zip(*map(jax.tree.leaves, (moment, direction)), strict=True))
        h = 1e-6
        np.testing.assert_allclose(slope, (loss(h) - loss(-h)) / (2 * h), rtol=1e-5)


def test_a_fit_of_fog_learns_it(data) -> None:
    """Ninety steps lower both losses twentyfold: fog is one σ and one ρ, and its renders are known."""
    config, _ = adapt_nerf_tex(replace(CONFIG, near_kimg=0.01, rate=3e-3), data)
    at, state = renders(config, data), start(config, jax.random.key(0))
    learn = jax.jit(lambda s, b: step(config, s, b))
    reports = []
    for i in range(90):
        state, report = learn(state, at(i))
        reports.append([float(report.radiance), float(report.transmittance)])
    first, last = np.mean(reports[:3], axis=0), np.mean(reports[-5:], axis=0)
    assert (last < first / 20).all(), (first, last)


def test_all_that_it_is_told_changes_the_picture(batch) -> None:
    """Every parameter, the camera, the light, and its irradiance, which scales radiance and leaves alpha alone."""
    decoder, run = start(CONFIG, jax.random.key(0)).decoder, jax.jit(lambda d, b: paint(CONFIG, d, b, HERE.each))
    before = run(decoder, batch)
    other = batch._replace(
        alpha=batch.alpha + 0.3,
        beta=batch.beta + 0.3,
        camera_to_world=batch.camera_to_world.at[:, :3, 3].add(0.1),
        light=batch.light[:, jnp.array([2, 1, 0])],
    )
    for name in ("alpha", "beta", "camera_to_world", "light"):
        after = run(decoder, batch._replace(**{name: getattr(other, name)}))
        changed = jnp.abs(after - before)
        assert changed[..., :3].max() > 1e-3, name
        assert (changed[..., 3].max() > 1e-4) == (name != "light"), name
    bright = run(decoder, batch._replace(irradiance=2 * batch.irradiance))
    np.testing.assert_allclose(bright, np.asarray(before) * np.array([2, 2, 2, 1], np.float32), rtol=1e-5, atol=1e-7)


def test_a_place_is_seen_by_its_sines_and_cosines() -> None:
    config = NerfTexConfig(octaves=2, parameters=1)
    point = Point(jnp.array([0.25, 0.5, 1.0]), jnp.float32(0), jnp.float32(0), jnp.array([0.5]))
    root = 0.5**0.5
    expected = [0.25, root, 1, root, 0, 0.5, 1, 0, 0, -1, 1.0, 0, 0, -1, 1, 0.5, 1, 0, 0, 0, 0, -1, 1, 1]
    np.testing.assert_allclose(see(config, point), expected, atol=1e-6)


def test_seeds_are_one_more_parameter(data) -> None:
    """Each sample's is its own; a new picture's is drawn by its key, and the other parameters stay."""
    config, seen = adapt_nerf_tex(replace(CONFIG, seeded=True), data)
    assert config.parameters == 2 and SEED in seen.manifest["parameters"] and SEED not in data.manifest["parameters"]
    views = views_of(config, seen, list(range(8)))
    np.testing.assert_allclose(views.beta[:, 0], (np.arange(8) + 0.5) / 8)
    drawn = redrawn(config, views)
    assert len(np.unique(drawn.beta)) == 8 and not np.isin(drawn.beta, views.beta).any()
    assert ((drawn.beta >= 0) & (drawn.beta < 1)).all()
    np.testing.assert_array_equal(drawn.alpha, views.alpha)
    np.testing.assert_array_equal(redrawn(config, views).beta, drawn.beta)
    other = redrawn(config, views._replace(key=views.key[::-1]))
    np.testing.assert_array_equal(other.beta, drawn.beta[::-1])
    assert redrawn(replace(config, seeded=False), views) is views


def test_seeds_stay_apart_in_the_largest_dataset(data) -> None:
    """25 000 samples, the paper's number, have 25 000 seeds in float32."""
    many = with_seeds(replace(data, samples=data.samples[:1] * 25_000))
    assert len({np.float32(sample.parameters[SEED]) for sample in many.samples}) == 25_000


def test_geometry_that_cannot_be_told_apart_is_refused(data) -> None:
    other = replace(data, recipe="carpet2", manifest=data.manifest | {"patch": None})
    with pytest.raises(
        InputError, match=r"cannot tell apart: render one patch \(mesoshell dataset render carpet2 --patch 0"
    ):
        adapt_nerf_tex(CONFIG, other)
    same = replace(data, manifest=data.manifest | {"patch": 3})
    with pytest.raises(
        InputError, match="every image shows patch 3; seeds as a parameter need a dataset without --patch"
    ):
        adapt_nerf_tex(replace(CONFIG, seeded=True), same)
    assert (
        adapt_nerf_tex(CONFIG, same)[0].parameters
        == adapt_nerf_tex(replace(CONFIG, seeded=True), other)[0].parameters - 1
    )
    with pytest.raises(InputError, match="has images of 8 × 8 pixels; the experiment expects 16 × 16"):
        adapt_nerf_tex(replace(CONFIG, picture=replace(CONFIG.picture, size=16)), data)


@pytest.mark.slow  # two hosts take its steps both ways in test_two_hosts
def test_one_device_sharded_and_pmap_agree() -> None:
    """Losses and gradients to 1e-6 in float64, eight devices with one row each."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.helpers.parametric_step"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout.splitlines()[-1])
    assert len(said) == 6
    for name, value in said.items():
        assert value == 8 if name.endswith("images") else value < 1e-6, name


@pytest.mark.slow  # test_two_hosts goes on with one, the generator's commands read one
def test_a_run_is_recorded_resumed_and_read_back(data, tmp_path) -> None:
    """Its configuration returns from its record; a GAN's experiment is refused in its folder; a longer one goes on."""
    config = replace(CONFIG, seeded=True, kimg=0.016)
    train(config, data, tmp_path)
    adapted, _ = adapt_nerf_tex(config, data)
    read, about = read_record(tmp_path)
    assert read == adapted and method_of(read) is NERF_TEX and SEED not in about["parameters"]
    assert json.loads((tmp_path / "config.json").read_text())["method"] == "nerf_tex"
    with pytest.raises(InputError, match="the run was begun by another method: nerf_tex, asked for gan"):
        keep_record(TINY, data, tmp_path)
    on = train(replace(config, kimg=0.032), data, tmp_path)
    whole = train(replace(config, kimg=0.032), data, tmp_path / "whole")
    assert int(on.images) == 32
    for a, b in zip(jax.tree.leaves(on), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_snapshot_is_the_network(data, tmp_path) -> None:
    config, _ = adapt_nerf_tex(CONFIG, data)
    state = start(config, jax.random.key(3))
    save(tmp_path / "a.npz", config, data, state)
    views = views_of(config, data, [0, 5])
    np.testing.assert_array_equal(
        load_predictor(config, tmp_path / "a.npz")(views), pictures(config, state.decoder, views)
    )
    with pytest.raises(InputError, match=r"a\.npz: array trunk/0/kernel is not of shape \(\d+, 5\) and float32"):
        load_predictor(replace(config, trunk=(5, 4)), tmp_path / "a.npz")


def test_a_preset_gives_its_size() -> None:
    config = nerf_tex_config(TINY)
    assert config.trunk == (32,) * 4 and config.head == (16,) and config.octaves == 5
    assert config.picture == TINY.picture and (config.batch, config.kimg) == (TINY.batch, TINY.kimg)
