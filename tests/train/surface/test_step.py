"""Training a surface material: what a step sees and minimises, that it learns what is known, and that runs go on to the bit."""

import json
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mesoshell.errors import InputError
from mesoshell.io.query_dataset import Patches, read_patches
from mesoshell.io.surface import SurfaceBundle, read_surface
from mesoshell.measure.queries import QUERIES, score
from mesoshell.surface_material.loader import surface_of
from mesoshell.surface_material.network import OpacityEval, Surface, SurfaceConfig
from mesoshell.train import run
from mesoshell.train.gan.presets import SMALL, TINY
from mesoshell.train.method import SURFACE, method_of
from mesoshell.train.run import Diverged, train
from mesoshell.train.run_config import keep_record, read_record
from mesoshell.train.surface import step as surface
from mesoshell.train.surface.snapshot import bundle, load_predictor, save, sheet
from mesoshell.train.surface.step import (
    COARSE,
    FINE,
    FREEZE,
    HELD,
    SHRINK,
    WIDE,
    QueryBatch,
    SurfaceState,
    SurfaceTrainConfig,
    adapt,
    ask,
    blur_at,
    feed,
    held_out,
    query_batch,
    start,
    step,
    surface_config,
)
from mesoshell.train.update import Across
from tests.helpers import wearing

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("train_surface")

CONFIG = SurfaceTrainConfig(
    SurfaceConfig(8, 3, (8,)), batch=256, kimg=256 * 0.1, snapshot_kimg=256 * 0.05, curvature=(-1.0, 2.0), fine=COARSE
)
FORMS = ("direct", "cosine", "none")


def numbered(count: int, index: int) -> np.ndarray:
    """A patch whose rows say which patch, in r, and which row they are, in g."""
    return wearing.rows(
        count,
        index,
        lambda q: {"alpha": 1, "cosine": 0, "rgb": np.stack([q["r"] * 0 + index, np.arange(count), q["r"]], 1)},
    )


def uneven(q: dict[str, np.ndarray]) -> dict[str, Any]:
    """Answers that follow from the query: partly met, and dark where nothing is."""
    alpha = np.clip(0.5 + q["w"][:, 2] * 0.7 - 0.3 * q["kappa"], 0, 1)
    rgb = alpha[:, None] * (0.1 + 0.05 * np.sin(2 * np.pi * q["u"][:, :1]) + 0.1 * np.maximum(q["light"], 0))
    return {"alpha": alpha, "cosine": np.clip(0.3 + 0.1 * q["kappa"], 0, 1), "rgb": rgb}


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Patches:
    """Six patches of 64 queries; the last is held out."""
    folder = tmp_path_factory.mktemp("data") / "set"
    return read_patches(wearing.write_patches(folder, [wearing.rows(64, k, uneven) for k in range(6)]))


def batch_of(answer: Callable, count: int = 256, seed: int = 0) -> QueryBatch:
    parts = [wearing.rows(count // 4, 10 * seed + k, answer) for k in range(4)]
    return jax.tree.map(jnp.asarray, query_batch(np.concatenate(parts)))


def learned(
    config: SurfaceTrainConfig, batches: list[QueryBatch], steps: int
) -> tuple[SurfaceState, list[list[float]]]:
    state, learn = start(config, jax.random.key(0)), jax.jit(lambda s, b: step(config, s, b))
    losses = []
    for i in range(steps):
        state, report = learn(state, batches[i % len(batches)])
        losses.append([float(report.reflectance), float(report.opacity)])
    return state, losses


def answered(config: SurfaceTrainConfig, surface: Surface, batch: QueryBatch, blur: float) -> tuple[OpacityEval, Any]:
    return jax.jit(lambda s, b: ask(config, s, b, jnp.float32(blur)))(surface, batch)


def as_bundle(config: SurfaceTrainConfig, surface: Any) -> SurfaceBundle:
    """The network's numbers by the names of the file, in float64."""
    arrays = {}
    for name, module in surface._asdict().items():
        arrays |= {f"{name}/texture/{i}": x for i, x in enumerate(module.texture)}
        layers = {f"hidden/{i}": x for i, x in enumerate(module.hidden)} | {"last": module.last}
        for key, layer in layers.items():
            arrays |= {f"{name}/{key}/{k}": v for k, v in layer._asdict().items()}
    arrays = {k: np.asarray(v, np.float64) for k, v in arrays.items()}
    s = config.surface
    return SurfaceBundle(
        s.texels, s.channels, s.opacity, s.step, s.offset, s.curvature, config.curvature, 0.1, {}, arrays
    )


def losses_of(b: SurfaceBundle, blur: float, batch: QueryBatch) -> tuple[float, float]:
    """Of reflectance and of opacity, in float64, as the module says."""
    soft = {
        k: gaussian_filter(v, (blur, blur, 0), mode="wrap", truncate=9.0) if "/texture/" in k else v
        for k, v in b.arrays.items()
    }
    q: Any = {k: np.asarray(v, np.float64) for k, v in batch._asdict().items()}
    alpha, cosine, rho = wearing.answers(replace(b, arrays=soft), q["u"], q["radius"], q["w"], q["kappa"], q["light"])
    met = q["alpha"][:, None]
    x, wanted = np.pi * rho, np.pi * q["rgb"] / np.maximum(met, 1e-3)
    reflectance = (met * ((np.log1p(x) - np.log1p(wanted)) ** 2 + 0.1 * np.abs(x - wanted))).mean()
    p, t = np.clip(alpha, 1e-6, 1 - 1e-6), q["alpha"]
    opacity = {
        "direct": -(t * np.log(p) + (1 - t) * np.log(1 - p)).mean(),
        "cosine": ((cosine - q["cosine"]) ** 2).mean(),
        "none": 0.0,
    }[b.opacity]
    return reflectance, opacity


def test_a_step_depends_on_its_number_alone(data) -> None:
    one, two = feed(CONFIG, data), feed(CONFIG, data)
    two(3)
    for i in (0, 7):
        for x, y in zip(one(i), two(i), strict=True):
            np.testing.assert_array_equal(x, y)
    assert (one(0).u != one(1).u).any() and (one(0).u != feed(replace(CONFIG, seed=1), data)(0).u).any()


@pytest.fixture(scope="module")
def counted(tmp_path_factory) -> Patches:
    """Seventy patches of forty queries that say where they are from."""
    folder = tmp_path_factory.mktemp("data") / "set"
    return read_patches(wearing.write_patches(folder, [numbered(40, k) for k in range(70)]))


def test_what_is_held_out_is_not_learned_from(counted) -> None:
    """One patch in so many, at the end; of all others every query comes, in runs of neighbours."""
    learn, test = held_out(counted)
    assert len(test) == 70 // HELD == 2 and len(learn) == 68
    assert {int(p[0, 12]) for p in test} == {68, 69}
    at = feed(CONFIG, counted)
    came = np.concatenate([at(i).rgb for i in range(400)])
    assert {(int(p), int(q)) for p, q in came[:, :2]} == {(p, q) for p in range(68) for q in range(40)}
    runs = at(5).rgb[:, :2].reshape(64, 4, 2)
    assert (runs[:, :, 0] == runs[:, :1, 0]).all() and (np.diff(runs[:, :, 1], axis=1) == 1).all()
    assert len(np.unique(runs[:, 0], axis=0)) > 40


@pytest.mark.parametrize("hosts", [2, 4, 64])
def test_hosts_share_a_step(counted, hosts: int) -> None:
    def sorted_rows(*parts: QueryBatch) -> np.ndarray:
        rows = np.concatenate([np.concatenate([p.rgb, p.u, p.w, p.light], axis=1) for p in parts])
        return rows[np.lexsort(rows.T)]

    parts = [feed(CONFIG, counted, host, hosts)(9) for host in range(hosts)]
    assert {len(p.u) for p in parts} == {256 // hosts}
    np.testing.assert_array_equal(sorted_rows(*parts), sorted_rows(feed(CONFIG, counted)(9)))


def test_columns_come_by_their_meaning() -> None:
    rows = np.arange(32, dtype=np.float32).reshape(2, 16)
    found = query_batch(rows)
    wanted = {"u": [0, 1], "radius": 2, "w": [3, 4, 5], "kappa": 6, "light": [7, 8, 9], "alpha": 10, "cosine": 11}
    for name, columns in (wanted | {"rgb": [12, 13, 14]}).items():
        np.testing.assert_array_equal(getattr(found, name), rows[:, columns])


def test_what_is_too_little_or_uneven_is_refused(data, tmp_path) -> None:
    alone = read_patches(wearing.write_patches(tmp_path / "one", [numbered(8, 0)]))
    with pytest.raises(InputError, match=r"one: has 1 patch: one is held out, others are learned from"):
        adapt(CONFIG, alone)
    with pytest.raises(InputError, match="has 64 queries in a patch; a step takes 128"):
        feed(replace(CONFIG, batch=64 * 128), data)
    with pytest.raises(InputError, match="batch: 100 queries do not come evenly from 64 patches for 1 hosts"):
        feed(replace(CONFIG, batch=100), data)
    with pytest.raises(InputError, match="for 3 hosts"):
        feed(CONFIG, data, 0, 3)
    assert len(feed(replace(CONFIG, batch=16), data)(0).u) == 16


@pytest.mark.parametrize(
    "manifest",
    [
        {"curvature": None},
        {"curvature": [1.0]},
        {"curvature": [1.0, 1.0]},
        {"curvature": ["a", "b"]},
        {"depth": None},
        {"depth": 0},
    ],
)
def test_a_dataset_that_does_not_say_what_it_is_of_is_refused(tmp_path, manifest: dict) -> None:
    found = read_patches(wearing.write_patches(tmp_path / "set", [numbered(8, k) for k in range(3)], **manifest))
    with pytest.raises(InputError, match=r"set/manifest\.json: has no range of curvature, or no depth") as fault:
        adapt(CONFIG, found)
    assert "\n" not in str(fault.value)


def test_the_datasets_curvature_is_the_materials(tmp_path) -> None:
    """It reaches the configuration and the file, and is what networks see as −1 to 1."""
    patches = [wearing.rows(16, k, uneven) for k in range(3)]
    found = read_patches(wearing.write_patches(tmp_path / "set", patches, curvature=[-4, 0.5]))
    config, same = adapt(CONFIG, found)
    assert config.curvature == (-4.0, 0.5) and same is found
    assert config == replace(CONFIG, curvature=(-4.0, 0.5))
    state = start(config, jax.random.key(0))
    assert bundle(config, found, state).curvature == (-4.0, 0.5)
    batch = batch_of(uneven)
    seen, rho = answered(config, state.surface, batch, 1e-3)
    alpha, _, wanted = wearing.answers(
        as_bundle(config, state.surface), batch.u, batch.radius, batch.w, batch.kappa, batch.light
    )
    inside = np.asarray(batch.kappa) <= 0.5  # beyond, the file's description holds it to the range
    assert inside.sum() > 50
    np.testing.assert_allclose(np.asarray(seen.alpha)[inside], alpha[inside], atol=1e-5)
    np.testing.assert_allclose(np.asarray(rho)[inside], wanted[inside], rtol=1e-4)


@pytest.mark.parametrize("opacity", FORMS)
@pytest.mark.parametrize("share", [0.0, 0.45, 1.0])
def test_losses_and_their_slopes(opacity: Any, share: float) -> None:
    """Against float64: values, and the gradient along a direction against differences; textures blurred as is due."""
    config = replace(CONFIG, surface=replace(CONFIG.surface, opacity=opacity))
    state, batch = start(config, jax.random.key(1)), batch_of(uneven)
    lively = jax.tree.map(lambda x: 3 * x, state.surface)
    state = state._replace(surface=lively, images=jnp.asarray(round(share * config.kimg * 1000), jnp.int32))
    heard: list[Any] = []

    def overheard(tree: Any) -> Any:
        heard.append(tree)
        return tree

    both = jax.jit(lambda s, b: (step(config, s, b, Across(mean=overheard)), heard[0][1]))
    (_, report), gradient = both(state, batch)
    blur = WIDE * (COARSE / WIDE) ** min(share / SHRINK, 1)
    begun, random = as_bundle(config, lively), np.random.default_rng(3)
    wanted = losses_of(begun, blur, batch)
    np.testing.assert_allclose([report.reflectance, report.opacity], wanted, rtol=1e-4)
    assert wanted[0] > 0.01 and not np.asarray(report.bad).any()
    along = {k: random.normal(size=v.shape) for k, v in begun.arrays.items()}
    slopes = as_bundle(config, gradient).arrays

    def total(h: float) -> float:
        return sum(
            losses_of(replace(begun, arrays={k: v + h * along[k] for k, v in begun.arrays.items()}), blur, batch)
        )

    slope = sum(float((slopes[k] * along[k]).sum()) for k in along)
    h = 1e-7
    np.testing.assert_allclose(slope, (total(h) - total(-h)) / (2 * h), rtol=2e-3)


@pytest.mark.parametrize("fine", [FINE, COARSE])
def test_the_blur_goes_from_wide_to_fine_geometrically(fine: float) -> None:
    def at(share: float) -> float:
        return float(blur_at(replace(CONFIG, fine=fine), jnp.float32(share)))

    wanted = [8, (8 * fine) ** 0.5, fine, fine, fine]
    np.testing.assert_allclose([at(0), at(SHRINK / 2), at(SHRINK), at(0.9), at(7.0)], wanted, rtol=1e-5)
    steps = [at(x) for x in np.linspace(0, SHRINK, 7)]
    np.testing.assert_allclose(np.diff(np.log(steps)), np.log(fine / WIDE) / 6, rtol=1e-4)


@pytest.mark.parametrize("each, fine", [(8, 1.0), (512, 0.5), (2048, 0.25), (12800, 0.1), (51200, 0.1)])
def test_the_fewer_queries_the_wider_the_least_blur(data, each: int, fine: float) -> None:
    """As many queries a texel are learned from; those that are held out count for nothing."""
    rows = np.zeros((each, 16), np.float32)
    config = replace(CONFIG, surface=replace(CONFIG.surface, texels=1))
    found, _ = adapt(config, replace(data, patches=(rows, rows)))
    assert found.fine == pytest.approx(fine) and found == replace(config, curvature=found.curvature, fine=found.fine)
    assert float(blur_at(found, jnp.float32(1))) == pytest.approx(fine)


def test_devices_that_hold_rows_of_their_own_agree_with_one() -> None:
    """As under pmap: four shares of a batch, losses and gradients meaned, are the whole batch's."""
    state, batch = start(CONFIG, jax.random.key(0)), batch_of(uneven)
    done = round(0.5 * CONFIG.kimg * 1000)
    state = state._replace(images=jnp.asarray(done, jnp.int32))
    whole, report = jax.jit(lambda s, b: step(CONFIG, s, b))(state, batch)
    shares = jax.tree.map(lambda x: x.reshape(4, 64, *x.shape[1:]), batch)

    def everyone(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.lax.all_gather(x, "i", tiled=True), jax.lax.axis_index("i")

    across = Across(lambda tree: jax.lax.pmean(tree, "i"), everyone)
    parts, said = jax.jit(jax.vmap(lambda b: step(CONFIG, state, b, across), axis_name="i"))(shares)
    assert (np.asarray(parts.images) == done + 256).all() and int(whole.images) == done + 256 and int(whole.step) == 1
    np.testing.assert_allclose(said.reflectance, np.full(4, report.reflectance), rtol=1e-5)
    np.testing.assert_allclose(said.opacity, np.full(4, report.opacity), rtol=1e-5)
    for x, y in zip(jax.tree.leaves(parts.adam), jax.tree.leaves(whole.adam), strict=True):
        np.testing.assert_allclose(x, np.broadcast_to(y, x.shape), rtol=1e-3, atol=1e-3 * np.abs(y).max())


def test_the_offset_is_frozen_at_last() -> None:
    """To the bit, whatever Adam remembers; all else goes on learning."""
    batch, learn = batch_of(uneven), jax.jit(lambda s, b: step(CONFIG, s, b))
    state, _ = learn(start(CONFIG, jax.random.key(0)), batch)

    def changed(share: float) -> dict[str, list[bool]]:
        before = state._replace(images=jnp.asarray(round(share * CONFIG.kimg * 1000), jnp.int32))
        after, _ = learn(before, batch)
        return {
            name: [
                bool((x != y).any())
                for x, y in zip(*map(jax.tree.leaves, (module, getattr(after.surface, name))), strict=True)
            ]
            for name, module in before.surface._asdict().items()
        }

    before, after = changed(FREEZE - 0.02), changed(FREEZE + 0.02)
    assert any(before["offset"]) and not any(after["offset"])
    for name in ("opacity", "reflectance"):
        assert sum(after[name]) == sum(before[name]) > 4


@pytest.mark.parametrize("opacity", FORMS)
def test_a_known_constant_is_learned(opacity: Any) -> None:
    """α, or the silhouette cosine, and ρ of everything; rgb is of all rays, and ρ of those that meet something."""
    alpha, cosine, rho = 0.3, 0.4, np.array([0.05, 0.1, 0.2])
    config = replace(CONFIG, surface=replace(CONFIG.surface, opacity=opacity), rate=1e-2, kimg=0.256 * 150)

    def answer(q: dict[str, np.ndarray]) -> dict[str, Any]:
        return {"alpha": alpha, "cosine": cosine, "rgb": alpha * rho}

    state, losses = learned(config, [batch_of(answer, seed=k) for k in range(6)], 150)
    fresh = batch_of(answer, seed=99)
    found, made = answered(config, state.surface, fresh, COARSE)
    assert losses[-1][0] < 0.1 * losses[0][0]
    assert np.median(np.abs(np.asarray(made) / rho - 1)) < 0.05
    if opacity == "direct":
        assert np.median(np.abs(np.asarray(found.alpha) - alpha)) < 0.03
    elif opacity == "cosine":
        assert np.median(np.abs(np.asarray(found.cosine) - cosine)) < 0.03
    else:
        first = start(config, jax.random.key(0)).surface.opacity
        assert {row[1] for row in losses} == {0.0}
        for x, y in zip(jax.tree.leaves(first), jax.tree.leaves(state.surface.opacity), strict=True):
            np.testing.assert_array_equal(x, y)


def test_two_updates_lower_the_loss() -> None:
    batch = batch_of(uneven)
    _, losses = learned(CONFIG, [batch], 3)
    assert sum(losses[2]) < sum(losses[1]) < sum(losses[0])


def test_what_follows_from_curvature_is_learned_by_what_sees_it() -> None:
    def answer(q: dict[str, np.ndarray]) -> dict[str, Any]:
        bent = 1 / (1 + np.exp(-4 * (q["kappa"] - 0.5)))
        return {"alpha": bent, "cosine": 0, "rgb": bent[:, None] * (0.05 + 0.1 * bent[:, None])}

    def last(curvature: bool) -> np.ndarray:
        config = replace(CONFIG, surface=replace(CONFIG.surface, curvature=curvature), rate=1e-2, kimg=0.256 * 200)
        _, losses = learned(config, [batch_of(answer, seed=k) for k in range(8)], 200)
        return np.mean(losses[-20:], axis=0)

    sees, blind = last(True), last(False)
    assert sees[0] < 0.5 * blind[0] and sees[1] < blind[1] - 0.05  # of α the data's own entropy is left


def test_rays_that_meet_nothing_say_nothing_of_reflectance() -> None:
    """Neither in the loss nor in its gradient, whatever their colour; and all is finite."""
    batch = batch_of(lambda q: {"alpha": 0, "cosine": 0, "rgb": 7.0})
    heard: list[Any] = []

    def overheard(tree: Any) -> Any:
        heard.append(tree)
        return tree

    both = jax.jit(lambda s, b: (step(CONFIG, s, b, Across(mean=overheard)), heard[0][1]))
    (_, report), gradient = both(start(CONFIG, jax.random.key(0)), batch)
    assert float(report.reflectance) == 0 and np.isfinite(report.opacity)
    assert all(not np.asarray(x).any() for x in jax.tree.leaves((gradient.reflectance, gradient.offset)))
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradient)) and not np.asarray(report.bad).any()


def test_a_preset_gives_its_size() -> None:
    tiny, small = surface_config(TINY), surface_config(SMALL)
    assert tiny.surface.texels == 32 and round(tiny.kimg * 1000 / tiny.batch) == 200
    assert small == SurfaceTrainConfig() and round(small.kimg * 1000 / small.batch) == 30_000


def test_a_run_leaves_its_record_its_log_and_materials(data, tmp_path) -> None:
    """Of which its configuration and method are read; another one is refused in its folder."""
    config = replace(CONFIG, batch=64, kimg=0.64, snapshot_kimg=0.32)
    state = train(config, data, tmp_path)
    assert (int(state.step), int(state.images)) == (10, 640)
    row = json.loads((tmp_path / "log.jsonl").read_text().splitlines()[-1])
    assert row["kimg"] == 0.64 and {"reflectance", "opacity"} <= row.keys() and np.isfinite(list(row.values())).all()
    assert [p.name for p in sorted((tmp_path / "snapshots").iterdir())] == ["000000320.npz", "000000640.npz"]
    for path in (tmp_path / "snapshots").iterdir():
        assert read_surface(path).curvature == (-1.0, 2.0)
    read, about = read_record(tmp_path)
    assert read == config and method_of(read) is SURFACE
    assert about["source"] == "weave" and about["curvature"] == [-1.0, 2.0]
    assert json.loads((tmp_path / "config.json").read_text())["method"] == "surface"
    with pytest.raises(InputError, match="the run was begun by another method: surface, asked for gan"):
        keep_record(TINY, data, tmp_path)
    with pytest.raises(InputError, match=r"config\.surface\.texels is 8, asked for 16"):
        train(replace(config, surface=replace(config.surface, texels=16)), data, tmp_path)


@pytest.mark.slow
def test_a_run_that_a_signal_stopped_goes_on_to_the_same_bits(data, tmp_path, monkeypatch) -> None:
    config = replace(CONFIG, batch=64, kimg=0.64)

    def terminated(*arguments: Any) -> Callable[[int], QueryBatch]:
        at = feed(*arguments)

        def batch(i: int) -> QueryBatch:
            if i == 4:  # read while the fourth step is taken
                os.kill(os.getpid(), signal.SIGTERM)
            return at(i)

        return batch

    monkeypatch.setattr(run, "method_of", lambda _: SURFACE._replace(feed=terminated))
    assert int(train(config, data, tmp_path / "cut").step) == 4
    monkeypatch.undo()
    on, whole = (train(config, data, tmp_path / name) for name in ("cut", "whole"))
    assert int(on.step) == int(whole.step) == 10
    for x, y in zip(jax.tree.leaves(on), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(x, y)


def test_data_of_another_curvature_are_refused(data, tmp_path) -> None:
    """A run is of one dataset."""
    config = replace(CONFIG, batch=64, kimg=0.128)
    train(config, data, tmp_path / "run")
    other = read_patches(
        wearing.write_patches(
            tmp_path / "other", [wearing.rows(64, k, uneven) for k in range(6)], curvature=[-1.0, 3.0]
        )
    )
    with pytest.raises(InputError, match=r"config\.curvature is \[-1\.0, 2\.0\], asked for \[-1\.0, 3\.0\]"):
        train(replace(config, kimg=0.256), other, tmp_path / "run")


@pytest.mark.parametrize("column", [10, 13])
def test_what_is_not_finite_stops_the_run_by_name(tmp_path, monkeypatch, column: int) -> None:
    """As a computation that diverges would; patches that hold NaN are refused as they are read."""
    found = read_patches(wearing.write_patches(tmp_path / "set", [wearing.rows(64, k, uneven) for k in range(6)]))
    poison = np.where(np.arange(found.patches[0].shape[1]) == column, np.nan, 0).astype(np.float32)
    monkeypatch.setattr(surface, "query_batch", lambda rows: query_batch(rows + poison))
    with pytest.raises(
        Diverged, match=r"step 1: the gradient of surface\.\S+ is not finite; there is no checkpoint yet"
    ):
        train(replace(CONFIG, batch=64), found, tmp_path / "run")


@pytest.mark.parametrize("opacity", FORMS)
def test_a_snapshot_is_the_material_as_it_is(data, tmp_path, opacity: Any) -> None:
    """Blurred as it is at that time; its answers are the network's but for the textures' half precision."""
    config = replace(CONFIG, surface=replace(CONFIG.surface, opacity=opacity))
    state = start(config, jax.random.key(3))
    lively = jax.tree.map(lambda x: 3 * x, state.surface)
    state = state._replace(surface=lively, images=jnp.asarray(round(0.3 * config.kimg * 1000), jnp.int32))
    save(tmp_path / "a.npz", config, data, state)
    read = read_surface(tmp_path / "a.npz")
    assert (read.depth, read.opacity, read.texels) == (0.125, opacity, 8)
    assert read.provenance["queries"] == int(state.images) and read.provenance["dataset"]["source"] == "weave"
    rows = np.asarray(data.patches[0])
    alpha, cosine, rho = load_predictor(config, tmp_path / "a.npz")(rows)
    batch = jax.tree.map(jnp.asarray, query_batch(rows))
    wanted, wanted_rho = answered(config, lively, batch, WIDE * (COARSE / WIDE) ** 0.5)
    assert np.asarray(wanted_rho).std() > 1e-3
    np.testing.assert_allclose(alpha, wanted.alpha, atol=2e-3 if opacity != "cosine" else 0.05)
    np.testing.assert_allclose(cosine, wanted.cosine, atol=1e-3)
    np.testing.assert_allclose(rho, wanted_rho, rtol=5e-3, atol=1e-4)
    plain, _ = answered(config, lively, batch, 1e-3)
    if opacity == "direct":
        assert np.abs(np.asarray(plain.alpha) - alpha).mean() > 5 * np.abs(np.asarray(wanted.alpha) - alpha).mean()
    again = bundle(config, data, state._replace(surface=surface_of(read), images=jnp.asarray(2**30, jnp.int32)))
    for key, array in again.arrays.items():  # of the last blur: a tenth of a texel
        np.testing.assert_allclose(array, read.arrays[key], atol=1e-2)


def test_a_sheet_shows_the_material(data) -> None:
    state = start(CONFIG, jax.random.key(0))
    state = state._replace(surface=jax.tree.map(lambda x: 3 * x, state.surface))
    found = sheet(CONFIG, data, state)
    assert found.shape[2] == 3 and found.shape[1] == 2 * found.shape[0] and np.isfinite(found).all()
    assert found.min() >= 0 and found.std() > 0.01
    top, bottom = np.split(found, 2)
    assert np.abs(top - bottom).max() > 1e-3  # flat, and curved


def test_scores_are_errors() -> None:
    """By hand: relative squared error of ρ over what was met, and mean error of α; intervals from what patches differ by."""
    rows = np.zeros((4, 16), np.float32)
    rows[:, 10] = [1, 0.5, 0, 1]
    rows[:, 12:15] = rows[:, 10:11] * np.array([0.1, 0.2, 0.3])

    def said(rho: float, alpha: float) -> Callable:
        return lambda x: (
            np.full(len(x), alpha),
            np.zeros(len(x)),
            np.tile(rho * np.array([0.1, 0.2, 0.3]), (len(x), 1)),
        )

    perfect = score(lambda x: (x[:, 10], x[:, 11], np.tile([0.1, 0.2, 0.3], (len(x), 1))), (rows, rows))
    assert list(perfect) == list(QUERIES)
    for estimate in perfect.values():
        np.testing.assert_allclose(estimate, 0, atol=1e-12)
    first, second = score(said(1.5, 0.5), (rows,)).values()
    np.testing.assert_allclose(first, 0.25, rtol=1e-5)
    np.testing.assert_allclose(second, np.mean([0.5, 0, 0.5, 0.5]), rtol=1e-6)
    # two patches of which one is answered right
    answers = iter([said(1.0, 0.625)(rows), said(2.0, 0.625)(rows)])
    first, _ = score(lambda x: next(answers), (rows, rows)).values()
    spread = 12.7062 * np.std([0, 1], ddof=1) / np.sqrt(2)  # of Student, by one degree of freedom
    np.testing.assert_allclose(first, [0.5, 0.5 - spread, 0.5 + spread], rtol=1e-5)
    dark = score(said(1.0, 0.0), (np.zeros((3, 16), np.float32),))
    assert all(np.isfinite(x).all() for x in dark.values())
