"""A generator learns exemplars: scaling changes no answer, the start has their statistics, a critic sees what is lawful."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.io.archive import write_arrays
from mesoshell.io.bundle import Parameter, read_bundle, write_bundle
from mesoshell.io.exemplars import Exemplars, read_exemplars, write_exemplars
from mesoshell.io.material import find
from mesoshell.shell.generator.generator import map_latent, synthesise, synthesise_height
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.generator.texture_critic import WINDOW, CriticConfig, criticise, init_critic
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.shell.material.loader import decoder_of
from mesoshell.train import run
from mesoshell.train.export import decoder_arrays
from mesoshell.train.textures import adversarial, critic_view
from mesoshell.train.textures import snapshot as textures_snapshot
from mesoshell.train.textures.depth_map import TOP, from_above
from mesoshell.train.textures.exemplars import ScaledExemplars, feed, scale_exemplars
from mesoshell.train.textures.natural_start import wide
from mesoshell.train.textures.snapshot import bundle
from mesoshell.train.textures.state import TexturesConfig, TexturesState, adapt
from mesoshell.train.textures.step import start, step
from mesoshell.train.textures.synthesis import fold, latents, own_phases, settle_moments, standard, synthesise_patch
from mesoshell.train.transfer import transfer_from
from tests.helpers.quick_start import begin_soon

pytestmark = pytest.mark.xdist_group("textures")
SIDE, C = 32, 4
GENERATOR = GeneratorConfig(
    texels=SIDE, channel_base=256, channel_max=8, channels=C, layers=4, z=0, w=8, waves=2, height_width=8
)
CONFIG = TexturesConfig(GENERATOR, CriticConfig(critic_view.CHANNELS, width=2), batch=2, window=64, snapshot_kimg=1e9)
DECODER = init_decoder(jax.random.key(5), C + 1 + 2 + 1, (8, 8), (8,))
textures = jax.jit(synthesise_patch, static_argnums=(0, 5))


@pytest.fixture(scope="module")
def exemplars() -> Exemplars:
    """Two textures of filtered noise, channels of other means and deviations, correlated."""
    rng = np.random.default_rng(0)
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE, 1 / SIDE), np.fft.fftfreq(SIDE, 1 / SIDE)))
    noise = np.fft.fft2(rng.normal(size=(2, SIDE, SIDE, C)), axes=(1, 2)) / (1 + k[None, :, :, None]) ** 1.5
    mixed = np.fft.ifft2(noise, axes=(1, 2)).real @ rng.normal(size=(C, C))
    features = mixed / mixed.std(axis=(0, 1, 2)) * [3.0, 0.2, 1.0, 0.5] + [1.0, -2.0, 0.0, 0.3]
    height = rng.normal(size=(8, C))
    age = Parameter("age", "alpha", (0.0, 1.0), 0.0, "1", "how old")
    about = {"datasets": [{"recipe": "noise"}]}
    return Exemplars(
        features.astype(np.float32), height, np.zeros((2, 0), np.float32), decoder_arrays(DECODER), 1, (age,), about
    )


@pytest.fixture(scope="module")
def begun(exemplars: Exemplars) -> tuple[TexturesConfig, ScaledExemplars, TexturesState]:
    config, data = adapt(replace(CONFIG, kimg=0.12), exemplars)
    return config, data, start(config, data, jax.random.key(0))


def test_what_scales_exemplars_changes_no_answer(exemplars: Exemplars):
    data = scale_exemplars(exemplars)
    np.testing.assert_allclose(data.features.mean(axis=(0, 1, 2)), 0, atol=1e-5)
    np.testing.assert_allclose(data.features.std(axis=(0, 1, 2)), 1, rtol=1e-5)
    rest = jnp.asarray(np.random.default_rng(1).random((SIDE, SIDE, 4)), jnp.float32)
    row = np.asarray(exemplars.height[3], np.float32)
    given = net.trunk(decoder_of(exemplars.decoder), jnp.concatenate([exemplars.features[0] + row, rest], axis=-1))
    found = net.trunk(data.decoder, jnp.concatenate([data.features[0] + data.height[3], rest], axis=-1))
    for a, b in zip(given, found, strict=True):
        np.testing.assert_allclose(b, a, rtol=2e-4, atol=2e-5)


@pytest.mark.slow
def test_a_start_has_the_exemplars_mean_and_covariance(begun):
    config, data, state = begun
    assert state.a.shape == (2 * C, C)
    w, phases = latents(config, state.generator, jnp.zeros((64, 0))), own_phases(config, jnp.arange(64))
    x = np.asarray(textures(config, state, state.generator, w, phases, SIDE)[0]).reshape(-1, C)
    np.testing.assert_allclose(x.mean(axis=0), 0, atol=0.3)
    np.testing.assert_allclose(np.cov(x.T), np.corrcoef(data.features.reshape(-1, C).T), atol=0.4)


def test_a_material_makes_the_textures_of_the_run(begun):
    """What follows the last layer is folded into it, in the bundle too."""
    config, data, state = begun
    state = state._replace(averages=state.averages._replace(magnitude=[1.3 * m for m in state.averages.magnitude]))
    w, phases = latents(config, state.generator, jnp.zeros((1, 0))), own_phases(config, jnp.arange(1))
    expected = textures(config, state, state.generator, w, phases, SIDE)[0]
    g, corner = fold(state.generator, state), jnp.zeros(2, jnp.int32)
    synthesised = jax.jit(synthesise, static_argnums=(0, 6))
    found = synthesised(config.generator, g, state.averages, w, phases, corner, (SIDE, SIDE)).feature
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)
    tall = synthesise_height(wide(config.generator), state.generator, w)[..., :C]
    np.testing.assert_allclose(synthesise_height(config.generator, g, w), tall, rtol=1e-5, atol=1e-6)
    made_of = bundle(config, data, state)
    assert made_of.generator is not None and made_of.generator["z"] == 0 and not made_of.wraps
    np.testing.assert_array_equal(
        made_of.arrays["generator/layers/4/weight"], fold(state.smooth, state).layers[-1].weight
    )


def test_regression_repeats_its_exemplars(begun):
    config, data, state = begun
    assert state.versus is None  # what is not asked for is not there
    learn, at = jax.jit(lambda s, b: step(config, s, b)), feed(config, data)
    errors = []
    for i in range(60):
        state, report = learn(state, at(i))
        errors.append(float(report.error))
    assert np.mean(errors[-6:]) < 0.85 * np.mean(errors[6:12])
    assert float(report.height) < 0.5 and not np.asarray(report.bad).any()


@pytest.fixture(scope="module")
def against_a_critic(exemplars: Exemplars) -> tuple[TexturesConfig, ScaledExemplars, TexturesState]:
    generator = replace(GENERATOR, channel_base=128, channel_max=4)
    config, data = adapt(
        replace(CONFIG, generator=generator, adversarial=True, balance=0.6, rate=3e-3, kimg=0.1), exemplars
    )
    with pytest.MonkeyPatch.context() as patch:
        begin_soon(patch)
        return config, data, start(config, data, jax.random.key(0))


def test_both_players_are_train_states_of_flax(against_a_critic):
    config, _, state = against_a_critic
    players = ms.modules.train_states(config, state)
    assert players.keys() == {"generator", "critic"}
    for name, mine in players.items():
        expected = jax.tree.map(jnp.shape, mine.tx.init(mine.params))
        assert jax.tree.map(jnp.shape, mine.opt_state) == expected
        other = mine.replace(params=jax.tree.map(lambda x: x + 1, mine.params), step=mine.step + 7)
        moved = ms.modules.with_train_states(config, state, {name: other})
        assert moved.step == 7
        for rest, found in ms.modules.train_states(config, moved).items():
            for x, y in zip(jax.tree.leaves(found.params), jax.tree.leaves(players[rest].params), strict=True):
                np.testing.assert_array_equal(x, y + 1 if rest == name else y)


def test_a_step_against_a_critic_is_finite_and_moves_both(against_a_critic):
    config, data, state = against_a_critic
    learn, at = jax.jit(lambda s, b: step(config, s, b)), feed(config, data)
    first, report = learn(state, at(0))
    assert first.versus and state.versus
    # γ falls where the loss is above what it is steered to, by how much it is
    lead = np.clip((config.balance - float(report.critic)) / adversarial.REACH, -1, 1)
    np.testing.assert_allclose(first.versus.gamma, config.gamma * np.exp(adversarial.RATE * lead), rtol=1e-5)
    assert not np.asarray(report.bad).any() and np.isfinite(jax.tree.leaves(report._replace(bad=0))).all()
    second, report = learn(first, at(1))  # rates begin at 0
    assert second.versus and state.versus and float(report.error) == 0
    assert (np.asarray(second.versus.critic.out.kernel) != np.asarray(state.versus.critic.out.kernel)).any()
    assert (np.asarray(second.generator.mix) != np.asarray(state.generator.mix)).any()
    np.testing.assert_array_equal(second.decoder.sigma.kernel, state.decoder.sigma.kernel)


@pytest.mark.slow  # it compiles three steps in float64
def test_one_device_sharded_and_pmap_agree():
    """Textures of all devices share their mean and variance. (A bias that these undo has no gradient but rounding.)"""
    command = [sys.executable, "-m", "tests.helpers.critic_step"]
    done = subprocess.run(command, cwd=Path(__file__).parents[3], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout.splitlines()[-1])
    assert len(said) == 6
    for name, value in said.items():
        assert value < (1e-3 if name.endswith("generator") else 1e-9), name


@pytest.mark.slow  # it compiles a step for each; the test of a step has the law
@pytest.mark.parametrize(("balance", "grows"), [(0.0, False), (5.0, True)])
def test_a_critic_that_leads_too_far_is_held_back(against_a_critic, balance: float, grows: bool):
    """Its loss is about 0.7 at first: less than 5 is too far a lead, and more than 0 too small a one."""
    config, data, state = against_a_critic
    config = replace(config, balance=balance)
    found = jax.jit(lambda s, b: step(config, s, b))(state, feed(config, data)(0))[0].versus.gamma
    expected = config.gamma * np.exp(adversarial.RATE if grows else -adversarial.RATE)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_a_penalty_is_the_square_of_a_known_slope():
    """A critic whose logits are sums over windows that do not meet: each has the slope of its own weights."""
    weights = np.random.default_rng(0).normal(size=(4, 4, 3)).astype(np.float32)
    y = jnp.asarray(np.random.default_rng(1).normal(size=(2, 8, 8, 3)), jnp.float32)

    def judge(y):
        return jnp.einsum("bvpuqi,pqi->bvu", y.reshape(2, 2, 4, 2, 4, 3), weights, precision="highest")

    logits, penalty = adversarial._judged(judge, y)
    np.testing.assert_allclose(logits, judge(y), rtol=1e-5)
    np.testing.assert_allclose(penalty, np.sum(weights**2), rtol=1e-5)


def test_what_is_standard_has_no_mean_and_unit_variance():
    f = jnp.asarray(np.random.default_rng(0).normal(3, [0.5, 2.0, 7.0], (2, 32, 32, 3)), jnp.float32)
    found = np.asarray(standard(f))
    np.testing.assert_allclose(found.mean(axis=(0, 1, 2)), 0, atol=1e-5)
    np.testing.assert_allclose(found.std(axis=(0, 1, 2)), 1, atol=3e-3)
    np.testing.assert_allclose(standard(5 * f + 2), found, atol=1e-2)


def test_textures_without_any_variance_are_standard_with_a_finite_gradient():
    """A generator that has become constant can still learn."""
    f = jnp.full((2, 8, 8, 3), 4.0)
    value, pull = jax.vjp(standard, f)
    slope = pull(jnp.asarray(np.random.default_rng(0).normal(size=f.shape), jnp.float32))[0]
    np.testing.assert_array_equal(value, 0)
    assert np.isfinite(slope).all() and float(jnp.abs(slope).max()) > 0


def test_a_material_has_what_the_critic_was_shown(against_a_critic):
    """Its textures have the exemplars' mean and variance by themselves, however far the run's own have gone."""
    config, _, state = against_a_critic
    gone = state._replace(a=3 * state.a, b=state.b + 20)
    w, phases = latents(config, state.smooth, jnp.zeros((16, 0))), own_phases(config, jnp.arange(16))
    shown = np.asarray(textures(config, settle_moments(config, gone), state.smooth, w, phases, config.window)[0])
    np.testing.assert_allclose(shown.mean(axis=(0, 1, 2)), 0, atol=0.25)
    np.testing.assert_allclose(shown.std(axis=(0, 1, 2)), 1, atol=0.25)


def test_a_material_of_corner_tiles_is_an_exemplar(exemplars: Exemplars):
    """Its torus at half the texels is its own next level, and windows of it go around."""
    path = find("turf")
    turf = read_exemplars(path)
    assert turf.patches == 4 and turf.features.shape == (1, 512, 512, 32) and turf.recipe == "grass"
    generator = replace(GENERATOR, texels=64, channels=32)
    config, data = adapt(replace(CONFIG, generator=generator, adversarial=True, window=80), turf)
    coarse = read_bundle(path).arrays["features/1"].astype(np.float32)
    expected = (coarse - coarse.mean(axis=(0, 1))) / coarse.std(axis=(0, 1))
    np.testing.assert_allclose(data.features[0], expected, atol=0.02)
    rows = feed(config, data)(3)
    assert rows.feature.shape == (2, 80, 80, 32)
    v, u = np.argwhere((data.features[0] == rows.feature[0][0, 0]).all(axis=2))[0]
    np.testing.assert_array_equal(rows.feature[0], np.roll(data.features[0], (-v, -u), axis=(0, 1))[:80, :80])
    with pytest.raises(InputError, match="is a torus of many patches; the experiment needs each by itself"):
        adapt(replace(CONFIG, generator=generator), turf)


def test_exemplars_of_other_texels_and_too_few_are_refused(exemplars: Exemplars):
    with pytest.raises(InputError, match="has 32 texels a patch; the generator has 64"):
        adapt(replace(CONFIG, generator=replace(GENERATOR, texels=64)), exemplars)
    with pytest.raises(InputError, match="has 2 patches; the experiment needs 3"):
        adapt(replace(CONFIG, exemplars=3), exemplars)
    with pytest.raises(InputError, match="window: 32 texels are less than the critic's 64"):
        adapt(replace(CONFIG, adversarial=True, window=32), exemplars)


def test_no_latent_needs_no_z(begun):
    w = map_latent(begun[2].generator, jnp.zeros((3, 0)), jnp.zeros((3, 0)))
    np.testing.assert_array_equal(w[0], w[2])
    assert float(jnp.std(w)) > 0


def test_a_slab_from_above_is_its_closed_form():
    """σ the same everywhere: opacity of n layers, and the mean height of what is met first."""
    decoder = DECODER._replace(sigma=DECODER.sigma._replace(kernel=jnp.zeros((8, 1)), bias=jnp.full(1, 3.0)))
    sigma = float(decoder.scale * np.log(2))
    found = from_above(decoder, 1, jnp.ones((4, 4, C)), jnp.zeros((8, C)), jnp.full(1, 0.5), layers=6)
    o = -np.expm1(-sigma * TOP / 6)
    np.testing.assert_allclose(found.opacity, np.full((6, 4, 4), o), rtol=1e-5)
    over = (1 - o) ** np.arange(6)[::-1]
    np.testing.assert_allclose(found.cover, np.full((4, 4), 1 - (1 - o) ** 6), rtol=1e-5)
    np.testing.assert_allclose(found.depth[0, 0], np.sum(over * o * (np.arange(6) + 0.5) / 6 * TOP), rtol=1e-5)


@pytest.mark.parametrize("turn", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)])
def test_a_turned_texture_is_seen_turned(exemplars: Exemplars, turn: tuple[int, int, int]):
    """Layers, depth and views aslant of a flipped texture are the flips of what is seen of it; light is another matter."""
    data = scale_exemplars(exemplars)
    f = jnp.asarray(data.features[0])
    moved = jnp.flip(f, [axis for axis in (0, 1) if turn[axis]])
    moved = jnp.swapaxes(moved, 0, 1) if turn[2] else moved
    light, height = jnp.array([0.0, 0.0, 1.0]), jnp.asarray(data.height)
    a, b = (critic_view.see(data.decoder, 1, x, height, jnp.full(1, 0.3), light) for x in (f, moved))
    expected = critic_view.turn_view(a, jnp.int32(turn[0] + 2 * turn[1] + 4 * turn[2]))
    np.testing.assert_allclose(b, expected, rtol=1e-4, atol=1e-5)
    assert not np.allclose(b, a, atol=1e-3)


@pytest.mark.parametrize("t", range(8))
def test_a_direction_turns_with_the_picture_that_shows_it(t: int):
    """A dot on the side of the middle to which the angle points; v is the first axis."""
    side, angle = 65, 0.07
    for _ in range(2):
        u, v = (round(32 + 25 * f(2 * np.pi * angle)) for f in (np.cos, np.sin))
        picture = jnp.zeros((side, side, critic_view.CHANNELS)).at[v, u, 0].set(1.0)
        row, column = np.unravel_index(np.argmax(critic_view.turn_view(picture, jnp.int32(t))[..., 0]), (side, side))
        found = np.arctan2(row - 32, column - 32) / (2 * np.pi)
        angle = float(critic_view.turned_angle(jnp.float32(angle), jnp.int32(t)))
        assert 0 <= angle < 1 and abs((found - angle + 0.5) % 1 - 0.5) < 0.01
    drawn = np.asarray(jax.vmap(critic_view.draw_turn)(jax.random.split(jax.random.key(0), 4000)))
    assert abs(np.mean(drawn == t) - (0.3 if t == 0 else 0.1)) < 0.03


def test_parameters_that_are_fixed_are_left_out_and_directions_are_known(exemplars: Exemplars):
    def beta(name: str, unit: str, low: float, high: float) -> Parameter:
        return Parameter(name, "beta", (low, high), low, unit, "how it is")

    declared = [beta("length", "1", 0.0, 1.0), beta("lean", "rad", 0.0, 1.0), beta("lean_angle", "rad", 0.0, 2 * np.pi)]
    values = np.array([[0.5, 0.1, 0.9], [0.5, 0.7, 0.2]], np.float32)
    some = replace(exemplars, beta=values, parameters=(*declared, *exemplars.parameters))
    assert adapt(CONFIG, some)[0].directions == ()  # regression turns nothing
    config, data = adapt(replace(CONFIG, adversarial=True), some)
    assert config.generator.betas == config.critic.betas == 2 and config.directions == (1,)
    assert [p.name for p in data.what.parameters] == ["lean", "lean_angle", "age"]
    batch = feed(config, data)(0)
    np.testing.assert_array_equal(batch.beta, values[batch.patch, 1:])
    turned = adversarial._turned_beta(config, jnp.asarray(values[:, 1:]), jnp.array([0, 1]))
    np.testing.assert_allclose(turned, [[0.1, 0.9], [0.7, 0.8]], rtol=1e-6)
    config = replace(CONFIG, adversarial=True)
    assert adapt(config, replace(some, beta=values[:, :0], parameters=exemplars.parameters))[0].directions == ()


def test_a_view_aslant_looks_along_its_slant():
    """One column of matter: from aside it is seen where its layers lie against the view."""
    above = critic_view.Above(jnp.zeros((16, 128, 128)).at[:, 64, 64].set(1.0), *(jnp.zeros(1),) * 3)
    seen_from = np.asarray(critic_view._aslant(above, (32, 0), 128))
    rows = np.flatnonzero(seen_from[:, 64])
    assert rows.max() == 63 and rows.min() == 64 - 31  # the top in its place but for half a layer, the foot by 31 of 32
    heights = seen_from[rows, 64]
    assert (np.diff(heights[heights > 0]) > 0).all()


def test_a_logit_sees_its_window_alone():
    critic = init_critic(CriticConfig(3, width=4), jax.random.key(0))
    y = jax.random.normal(jax.random.key(1), (1, 128, 128, 3))
    other = y.at[:, 100:].add(1.0)
    a, b = (criticise(critic, x, jnp.zeros((1, 0))) for x in (y, other))
    assert a.ndim == 3 and a.shape[1] == a.shape[2] > 4
    changed = np.asarray(a != b)[0].any(axis=1)
    assert changed[-1] and not changed[: (100 - WINDOW) // 8 + 1].any() and changed[(100 - WINDOW) // 8 + 1]


def test_a_critic_is_told_of_parameters():
    critic = init_critic(CriticConfig(3, width=4, betas=2), jax.random.key(0))
    y = jax.random.normal(jax.random.key(1), (1, 64, 64, 3))
    a, b = (criticise(critic, y, jnp.full((1, 2), x)) for x in (0.2, 0.7))
    assert np.abs(np.asarray(a - b)).min() > 0


def test_a_run_keeps_a_material_and_a_sheet(exemplars: Exemplars, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(textures_snapshot, "SIDE", 16)
    begin_soon(monkeypatch)
    write_exemplars(tmp_path / "e.npz", exemplars)
    config = replace(CONFIG, kimg=0.004, snapshot_kimg=0.004)
    run.train(config, read_exemplars(tmp_path / "e.npz"), tmp_path / "run")
    assert [p.name for p in (tmp_path / "run" / "snapshots").iterdir()] == ["000000004.npz"]
    assert (tmp_path / "run" / "sheets" / "000000004.png").stat().st_size > 1000
    fewer, data = adapt(replace(config, exemplars=1), read_exemplars(tmp_path / "e.npz"))
    with pytest.raises(InputError, match=r"run: its decoder is not that of .*, or was scaled by other exemplars"):
        transfer_from(fewer, data, tmp_path / "run")


def test_a_run_begins_with_a_snapshot(begun, exemplars: Exemplars, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """What its textures are is kept; other exemplars, other networks and bundles without a generator are refused."""
    config, data, state = begun
    write_bundle(tmp_path / "grass.npz", bundle(config, data, state))
    begin_soon(monkeypatch)
    fresh = start(config, data, jax.random.key(9))
    lent = transfer_from(config, data, tmp_path / "grass.npz")(fresh)
    for own, given in zip(*(jax.tree.leaves(fold(s.smooth, s)) for s in (state, lent)), strict=True):
        np.testing.assert_allclose(given, own, rtol=1e-3, atol=1e-4)
    assert jax.tree.map(jnp.shape, lent) == jax.tree.map(jnp.shape, fresh)
    shorter = replace(config, generator=replace(config.generator, precision="bfloat16"))
    np.testing.assert_array_equal(
        transfer_from(shorter, data, tmp_path / "grass.npz")(fresh).smooth.mix, lent.smooth.mix
    )
    other = scale_exemplars(replace(exemplars, features=exemplars.features * 2))
    with pytest.raises(InputError, match="scaled by other exemplars"):
        transfer_from(config, other, tmp_path / "grass.npz")
    with pytest.raises(InputError, match="generator is not this run's: w is 8, asked for 16"):
        transfer_from(replace(config, generator=replace(config.generator, w=16)), data, tmp_path / "grass.npz")


def test_faulty_exemplars_are_refused_in_one_line(exemplars: Exemplars, tmp_path: Path):
    path = tmp_path / "e.npz"
    write_exemplars(path, exemplars)
    with np.load(path) as file:
        arrays = dict(file)
    for change, fault in (
        ({"beta": np.zeros((3, 0), np.float32)}, "features, height and beta do not match"),
        ({"features": np.full_like(arrays["features"], np.nan)}, "array features has NaN or infinite values"),
        ({"features": arrays["features"][0]}, "has no array features of 4 axes: not exemplars"),
        ({"manifest.json": np.frombuffer(b'{"kind": "shell"}', np.uint8)}, "manifest.json does not describe exemplars"),
    ):
        write_arrays(path, arrays | change)
        with pytest.raises(InputError, match=fault):
            read_exemplars(path)
