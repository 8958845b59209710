"""Runs go on where they stopped, bit for bit; refuse what is not theirs; stop when something is not finite."""

import errno
import json
import os
import shutil
import signal
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.io.image import read_png
from mesoshell.io.lock import alone_in
from mesoshell.io.pack import pack_dataset
from mesoshell.train import run, transfer
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.gan.curriculum import adapt, renders
from mesoshell.train.gan.state import GanConfig, TrainState
from mesoshell.train.method import GAN
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.nerf_tex.seeds import SEED
from mesoshell.train.nerf_tex.seeds import adapt as adapt_nerf_tex
from mesoshell.train.run import Diverged, train
from mesoshell.train.run_config import keep_record, read_record
from mesoshell.train.textures.state import TexturesConfig
from mesoshell.train.transfer import transfer_from
from tests.helpers import fog, small_step

#: One process compiles what its tests share. Where a read fails, orbax closes its event loop under others that are under way.
pytestmark = [
    pytest.mark.xdist_group("train_run"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

CONFIG = replace(
    small_step.CONFIG,
    picture=replace(small_step.CONFIG.picture, size=8),
    batch=4,
    kimg=0.016,
    near_kimg=0.01,
)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Dataset:
    """Fog seen from sixteen distances, packed at 8²."""
    folder = tmp_path_factory.mktemp("data")
    fog.write(folder / "fog", [(0.6, 0.3, 1.6 + 0.2 * k) for k in range(16)], size=8)
    pack_dataset(read_dataset(folder / "fog"), folder / "packed")
    return read_dataset(folder / "packed")


def leaves(state: TrainState) -> list[np.ndarray]:
    return [np.asarray(x) for x in jax.tree.leaves(state)]


@pytest.fixture(scope="module")
def whole(data, tmp_path_factory) -> tuple[TrainState, Path]:
    folder = tmp_path_factory.mktemp("run")
    return train(CONFIG, data, folder / "whole"), folder / "whole"


def test_a_run_leaves_its_record_its_log_and_a_checkpoint(whole) -> None:
    state, folder = whole
    assert int(state.step) == 4 and int(state.images) == 16
    row = json.loads((folder / "log.jsonl").read_text().splitlines()[-1])
    assert row["kimg"] == 0.016 and np.isfinite(list(row.values())).all()
    assert row["r1"] > 0  # due at the first step of the row's four: the row is their mean
    assert json.loads((folder / "config.json").read_text())["config"]["batch"] == 4
    assert max(int(p.name) for p in (folder / "checkpoints").iterdir() if p.name.isdigit()) == 4


def test_a_full_disk_under_the_log_names_it(tmp_path, monkeypatch) -> None:
    class Full(StringIO):
        def write(self, _text: str) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "open", lambda *_args: Full())
    book: Any = SimpleNamespace(config=CONFIG, heard=[{"r1": 1.0}], logged=0.0, board=True, folder=tmp_path)
    with pytest.raises(InputError, match=r"log\.jsonl: cannot be written: No space left on device"):
        run._Book.row(book, 4)


def test_a_run_shows_itself(whole) -> None:
    folder = whole[1]
    assert [p.name for p in (folder / "snapshots").iterdir()] == ["000000016.npz"]
    sheet = read_png(folder / "sheets" / "000000016.png")
    assert sheet.shape[1] > 4 * 16 and sheet[..., :3].std() > 0.01
    page = (folder / "report.html").read_text()
    assert page.count("<img") == 2 and "0.016 kimg" in page


def test_every_weight_of_generator_and_discriminator_has_had_a_gradient(whole) -> None:
    moments = whole[0].learner_adam[0].nu.generator, whole[0].discriminator_adam[0].nu
    none = [
        jax.tree_util.keystr(k)
        for k, x in jax.tree_util.tree_leaves_with_path(moments)
        if not np.any(np.asarray(x) > 0)
    ]
    assert none == []


@pytest.mark.slow  # test_two_hosts does the same of one host and of several
def test_a_run_that_a_term_signal_stopped_goes_on_to_the_same_bits(data, whole, tmp_path, monkeypatch) -> None:
    def terminated(*arguments):
        at = renders(*arguments)

        def batch(i: int):
            if i == 2:  # read while the second step is taken
                os.kill(os.getpid(), signal.SIGTERM)
            return at(i)

        return batch

    monkeypatch.setattr(run, "method_of", lambda config: GAN._replace(feed=terminated))
    before = signal.getsignal(signal.SIGTERM)
    assert int(train(CONFIG, data, tmp_path / "cut").step) == 2
    assert signal.getsignal(signal.SIGTERM) is before
    monkeypatch.undo()
    for a, b in zip(leaves(whole[0]), leaves(train(CONFIG, data, tmp_path / "cut")), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_a_run_goes_on_from_the_checkpoint_before_a_torn_one_and_its_log_has_each_row_once(
    data, whole, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(run, "SAVE_EVERY", 0.0)
    monkeypatch.setattr(run, "LOG_EVERY", 1)
    train(CONFIG, data, tmp_path / "torn")
    log = (tmp_path / "torn" / "log.jsonl").read_text().splitlines()
    for path in (tmp_path / "torn" / "checkpoints" / "4" / "default" / "d").iterdir():
        path.write_bytes(path.read_bytes()[:100])
    with pytest.warns(UserWarning, match=r"checkpoints/4: cannot be read; using the checkpoint before it"):
        again = train(CONFIG, data, tmp_path / "torn")
    for a, b in zip(leaves(whole[0]), leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    rows = [json.loads(line)["kimg"] for line in (tmp_path / "torn" / "log.jsonl").read_text().splitlines()]
    assert rows == [json.loads(line)["kimg"] for line in log] == [0.004, 0.008, 0.012, 0.016]


def test_a_run_begins_with_anothers_weights_and_goes_on_with_its_own(data, whole, tmp_path, monkeypatch) -> None:
    """What it begins with is its checkpoint 0: a run that is killed while it compiles needs the other one no more."""
    place, began = run.spread_step, []

    def killed(*arguments):
        def placed(state):
            began.append(state)
            raise KeyboardInterrupt

        return place(*arguments)._replace(place=placed)

    monkeypatch.setattr(run, "spread_step", killed)
    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, data, tmp_path / "a", transfer=whole[1])
    with Checkpoints(tmp_path / "a" / "checkpoints") as checkpoints:
        found = checkpoints.newest(whole[0])
    assert found is not None and found[0] == int(found[1].images) == 0
    begun = found[1]
    np.testing.assert_array_equal(begun.learner.generator.mix, whole[0].learner.generator.mix)
    assert not np.array_equal(begun.learner.generator.mapping[0].kernel, whole[0].learner.generator.mapping[0].kernel)
    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, data, tmp_path / "a")
    for a, b in zip(leaves(began[0]), leaves(began[1]), strict=True):
        np.testing.assert_array_equal(a, b)
    assert read_record(tmp_path / "a")[1]["transfer"] == str(whole[1].resolve())
    with pytest.raises(InputError, match=r"data.transfer is .*whole, asked for .*/a$"):
        train(CONFIG, data, tmp_path / "a", transfer=tmp_path / "a")


def test_a_run_on_pictures_begins_with_a_snapshot(data, whole, tmp_path, monkeypatch) -> None:
    """Of its averaged weights: the discriminator is its own. Other networks and parameters are refused."""
    state, path = whole[0], next((whole[1] / "snapshots").iterdir())
    config, shown = adapt(CONFIG, data)
    fresh = GAN.start(config, shown, jax.random.key(9))
    lent = transfer_from(config, shown, path)(fresh)
    for learner in (lent.learner, lent.smooth):
        for own, given in zip(leaves(state.smooth), leaves(learner), strict=True):
            np.testing.assert_array_equal(own, given)
    for own, given in zip(leaves(fresh.discriminator), leaves(lent.discriminator), strict=True):
        np.testing.assert_array_equal(own, given)
    assert jax.tree.map(np.shape, lent) == jax.tree.map(np.shape, fresh) and int(lent.images) == 0
    np.testing.assert_array_equal(lent.averages.magnitude[0], state.averages.magnitude[0])
    run_of_textures = tmp_path / "textures" / "snapshots"  # an older snapshot, then this one
    run_of_textures.mkdir(parents=True)
    (run_of_textures / "000000004.npz").write_bytes(b"another")
    shutil.copy(path, run_of_textures / "000000008.npz")
    monkeypatch.setattr(transfer, "read_record", lambda folder: (TexturesConfig(config.generator), {}))
    newest = transfer_from(config, shown, run_of_textures.parent)(fresh)
    for own, given in zip(leaves(lent.learner), leaves(newest.learner), strict=True):
        np.testing.assert_array_equal(own, given)
    made, texels = config.generator, 2 * config.generator.texels
    finer = replace(config, generator=replace(made, texels=texels, channel_base=2 * made.channel_base))
    for own, given in zip(leaves(lent.learner), leaves(transfer_from(finer, shown, path)(fresh).learner), strict=True):
        np.testing.assert_array_equal(own, given)
    narrower = replace(finer, generator=replace(finer.generator, channel_base=made.channel_base // 2))
    with pytest.raises(
        InputError, match=f"are not as wide as this run's: texels is {made.texels}, asked for {texels}, channel_base"
    ):
        transfer_from(narrower, shown, path)
    coarser = replace(config, generator=replace(made, texels=made.texels // 2))
    with pytest.raises(InputError, match=f"its generator is not this run's: texels is {made.texels}, asked for"):
        transfer_from(coarser, shown, path)
    wider = replace(config, generator=replace(config.generator, w=16))
    with pytest.raises(InputError, match="its generator is not this run's: w is 4, asked for 16"):
        transfer_from(wider, shown, path)
    with pytest.raises(InputError, match=r"its decoder is not this run's: trunk, head or picture\.octaves differ"):
        transfer_from(replace(config, trunk=(5,)), shown, path)
    others = {name: entry | {"range": [0.0, 9.0]} for name, entry in shown.manifest["parameters"].items()}
    with pytest.raises(InputError, match=r"its parameters are .*, or of other ranges"):
        transfer_from(config, replace(shown, manifest=shown.manifest | {"parameters": others}), path)


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_as_it_was_asked(
    data, whole, tmp_path, monkeypatch
) -> None:
    config = adapt(CONFIG, data)[0]
    keep_record(config, data, tmp_path / "a", whole[1])
    (tmp_path / "a" / "checkpoints" / "0.orbax-checkpoint-tmp-0").mkdir(parents=True)  # the first one, half written
    asked = []
    monkeypatch.setattr(run, "transfer_from", lambda config, data, folder: asked.append(folder))
    monkeypatch.setattr(run, "keep_record", lambda *given: asked.append(given[-1]) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train(CONFIG, data, tmp_path / "a")
    assert asked == [whole[1].resolve()] * 2


def test_a_snapshot_that_a_kill_left_out_is_made(data, whole, tmp_path, monkeypatch) -> None:
    shutil.copytree(whole[1], tmp_path / "a")
    last = max((tmp_path / "a" / "snapshots").iterdir())
    kept = last.read_bytes()
    last.unlink()
    train(CONFIG, data, tmp_path / "a")
    assert last.exists() and len(last.read_bytes()) == len(kept)


def test_weights_that_do_not_fit_are_refused_and_nothing_is_written(data, whole, tmp_path) -> None:
    wider = replace(CONFIG, trunk=(5,), picture=replace(CONFIG.picture, octaves=2))
    (tmp_path / "none").mkdir()
    shutil.copy(whole[1] / "config.json", tmp_path / "none")
    for config, folder, said in (
        (
            wider,
            whole[1],
            "its networks are not this run's: picture.octaves is 1, asked for 2, trunk is (4,), asked for (5,)",
        ),
        (
            replace(CONFIG, generator=replace(CONFIG.generator, fourier="off")),
            whole[1],
            "its networks are not this run's: generator.fourier is random, asked for off",
        ),
        (CONFIG, tmp_path / "none", "has no checkpoint yet"),
        (CONFIG, tmp_path / "nothing", "no such file"),
    ):
        with pytest.raises(InputError) as caught:
            train(config, data, tmp_path / "a", transfer=folder)
        assert str(caught.value).startswith(str(folder)) and str(caught.value).endswith(said)
    assert not (tmp_path / "a").exists() and not (tmp_path / "nothing").exists()
    with pytest.raises(InputError, match="weights can be transferred only between generators' runs"):
        transfer_from(NerfTexConfig(), data, whole[1])


def test_another_configuration_is_refused_before_anything_compiles(data, whole, monkeypatch) -> None:
    monkeypatch.setattr(run, "spread_step", None)
    with pytest.raises(InputError) as caught:
        train(replace(CONFIG, gamma=7.0, trunk=(9,)), data, whole[1])
    assert str(caught.value).endswith(
        "the run was begun with another configuration: config.gamma is 0.5, asked for 7.0, config.trunk is [4], asked for [9]"
    )


def test_a_folder_has_one_run_at_a_time(data, tmp_path) -> None:
    with alone_in(tmp_path / "run"), pytest.raises(InputError, match="run: another run is writing into it"):
        train(CONFIG, data, tmp_path / "run")
    assert not list((tmp_path / "run").iterdir())


def test_a_record_older_than_a_field_has_its_default(data, whole, tmp_path) -> None:
    """So a run goes on after a version that can do more; a field or a method that is not ours is refused."""
    config, path = adapt(CONFIG, data)[0], tmp_path / "config.json"
    kept = json.loads((whole[1] / "config.json").read_text())
    assert list(kept) == ["config", "data"] and read_record(whole[1]) == (config, kept["data"])
    old = json.loads(json.dumps(kept))
    for part, name in ((old["config"], "density"), (old["config"]["picture"], "filtering")):
        del part[name]
    path.write_text(json.dumps(old))
    assert read_record(tmp_path)[0] == config
    with pytest.raises(InputError, match=r"configuration: config.density is 0.0, asked for 0.25$"):
        keep_record(replace(config, density=0.25), data, tmp_path)
    del old["data"]["samples_per_pixel"]
    path.write_text(json.dumps(old))
    keep_record(config, data, tmp_path)
    assert json.loads(path.read_text()) == kept
    other = replace(data, manifest=data.manifest | {"samples_per_pixel": 7})
    with pytest.raises(InputError, match=r"configuration: data.samples_per_pixel is 1, asked for 7$"):
        keep_record(config, other, tmp_path)
    for strange in ({"config": kept["config"] | {"x": 1}}, {"method": "x"}, {"config": 3}):
        path.write_text(json.dumps(kept | strange))
        with pytest.raises(InputError, match=r"config\.json: is no record of a training run"):
            read_record(tmp_path)


def test_what_was_fixed_for_all_renders_is_no_parameter(data) -> None:
    """What it does cannot be learned, so no label, material or mapping network knows it."""
    fixed = replace(data, manifest=data.manifest | {"fixed_parameters": {"age": 0.5}})
    config, seen = adapt(CONFIG, fixed)
    assert (config.appearance, config.generator.betas) == (0, 0) and seen.manifest["parameters"] == {}
    batch = renders(config, seen, 0, 1)(0)
    assert batch.alpha.shape == (4, 0) and batch.beta.shape == (4, 0)
    assert adapt(CONFIG, data)[0].appearance == 1
    with pytest.raises(InputError, match=r"^mismatch: needs a dataset with parameters"):
        adapt(replace(CONFIG, mismatch=1.0), fixed)
    network, seen = adapt_nerf_tex(NerfTexConfig(CONFIG.picture, seeded=True), fixed)
    assert network.parameters == 1 and list(seen.manifest["parameters"]) == [SEED]


def test_a_folder_is_known_by_any_path_to_it(data, whole, tmp_path) -> None:
    """A path through a folder that is not there yet must not come by another run's record unseen."""
    shutil.copytree(whole[1], tmp_path / "run")
    kept = (tmp_path / "run" / "config.json").read_bytes()
    with pytest.raises(
        InputError, match=r"run/config\.json: the run was begun with another configuration: config.gamma"
    ):
        keep_record(replace(adapt(CONFIG, data)[0], gamma=7.0), data, tmp_path / "nothing" / ".." / "run")
    assert (tmp_path / "run" / "config.json").read_bytes() == kept and not (tmp_path / "nothing").exists()


@pytest.mark.slow
def test_what_is_not_finite_stops_the_run_by_name(data, whole, tmp_path, monkeypatch) -> None:
    def poisoned(*arguments):
        at = renders(*arguments)
        return lambda i: at(i)._replace(image=np.full_like(at(i).image, np.nan))

    monkeypatch.setattr(run, "method_of", lambda config: GAN._replace(feed=poisoned))
    shutil.copytree(whole[1], tmp_path / "bad")
    with pytest.raises(Diverged) as caught:
        train(replace(CONFIG, kimg=0.02), data, tmp_path / "bad")
    said = str(caught.value)
    assert said.startswith("step 5: the gradient of discriminator.colour.weight is not finite")
    assert said.endswith(f"the last good checkpoint is {tmp_path / 'bad/checkpoints/4'}")
    with pytest.raises(Diverged, match=r"^step 1: .* not finite; the last good checkpoint is .*/lent/checkpoints/0$"):
        train(CONFIG, data, tmp_path / "lent", transfer=whole[1])


def test_far_cameras_come_first_and_hosts_share_the_batch(data) -> None:
    config = adapt(CONFIG, data)[0]
    at = renders(config, data)

    def distance(i: int) -> np.ndarray:
        return np.linalg.norm(at(i).camera_to_world[:, :3, 3] - 0.5, axis=1)

    far = sorted(float(np.linalg.norm(s.camera_to_world[:3, 3] - 0.5)) for s in data.samples)[-4:]
    assert (distance(0) >= far[0] - 1e-5).all()
    assert min(distance(i).min() for i in range(4, 20)) < far[0]
    halves = [renders(config, data, host, 2)(5) for host in (0, 1)]
    np.testing.assert_array_equal(np.concatenate([h.key for h in halves]), at(5).key)
    assert [len(h.image) for h in halves] == [2, 2]


def test_images_of_another_size_are_refused(data) -> None:
    pictures = {"picture": replace(CONFIG.picture, size=16), "discriminator": replace(CONFIG.discriminator, size=16)}
    config: GanConfig = replace(CONFIG, **pictures)
    with pytest.raises(
        InputError, match=r"has images of 8 × 8 pixels; the experiment expects 16 × 16: mesoshell dataset pack"
    ):
        adapt(config, data)


def test_a_batch_that_parts_the_views_of_a_texture_is_refused(data, tmp_path) -> None:
    with pytest.raises(InputError, match="batch: 16 is no multiple of the 1 devices and the 3 views"):
        train(replace(CONFIG, batch=16, views=3), data, tmp_path / "run")


def test_views_that_would_share_a_group_are_refused(data) -> None:
    with pytest.raises(InputError, match="views: 2 of a texture need a batch of 8, not 4"):
        adapt(replace(CONFIG, views=2), data)
    with pytest.raises(InputError, match="views: 2 of a texture need a batch of 8, not 6"):
        adapt(replace(CONFIG, batch=6, views=2), data)
    both = replace(CONFIG.discriminator, kind="vision-aided")
    with pytest.raises(InputError, match="views: 2 of a texture need a batch of 8, not 4"):
        adapt(replace(CONFIG, views=2, discriminator=both), data)
    heads = replace(CONFIG.discriminator, kind="projected")  # a row's logits know no other row
    assert adapt(replace(CONFIG, views=2, discriminator=heads), data)[0].discriminator.kind == "projected"


def test_fields_that_do_not_fit_each_other_are_refused(data) -> None:
    misspelt = replace(CONFIG.discriminator)
    object.__setattr__(misspelt, "kind", "projcted")  # beartype, in tests alone, would refuse it first
    with pytest.raises(
        InputError, match=r"discriminator\.kind: is 'projcted'; there are residual, projected, vision-aided"
    ):
        adapt(replace(CONFIG, discriminator=misspelt), data)
    wider = replace(CONFIG, discriminator=replace(CONFIG.discriminator, size=16))
    finer = replace(CONFIG, picture=replace(CONFIG.picture, texels=64))
    for config, said in (
        (wider, "discriminator.size: is 16, and picture.size is 8: they must be the same"),
        (finer, "picture.texels: is 64, and generator.texels is"),
        (replace(CONFIG, r1_every=0), "r1_every: must be at least 1, not 0"),
    ):
        with pytest.raises(InputError, match=said):
            adapt(config, data)
