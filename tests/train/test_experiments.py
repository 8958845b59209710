"""Every experiment of the project takes two steps, at less than the smallest preset; a slow test runs through that preset; at
its own it is a configuration that fits. Files that differ only in their data are one experiment here."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from mesoshell.datasets.queries.render import Settings, render_patches
from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.io.exemplars import Exemplars
from mesoshell.io.pack import pack_dataset
from mesoshell.io.query_dataset import Patches, read_patches
from mesoshell.neutex.capture import Capture, read_capture
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.train.experiment import check_recipe, experiment_of, read_experiment
from mesoshell.train.export import decoder_arrays
from mesoshell.train.gan.curriculum import views_of
from mesoshell.train.gan.presets import PRESETS
from mesoshell.train.method import method_of
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig
from mesoshell.train.run import train
from mesoshell.train.run_config import RunConfig, read_record, snapshots
from mesoshell.train.surface.step import SurfaceTrainConfig
from mesoshell.train.textures.state import TexturesConfig
from tests.helpers import balls, fog

FILES = sorted((Path(__file__).parents[2] / "experiments").glob("*.py"))
#: A file for each configuration: one step differs from another by its configuration and its data alone.
DISTINCT = list({read_experiment(file, "tiny"): file for file in reversed(FILES)}.values())


def fog_at(size: int, folder: Path) -> Dataset:
    fog.write(folder / "fog", [(0.6, 0.3, 1.6 + 0.4 * k) for k in range(8)], size=size)
    pack_dataset(read_dataset(folder / "fog"), folder / "packed")
    return read_dataset(folder / "packed")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Dataset:
    return fog_at(8, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def larger(tmp_path_factory) -> Dataset:
    return fog_at(16, tmp_path_factory.mktemp("larger"))


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> dict[str, Capture]:
    """A painted ball, by the colour that a field learns of it; what learns reflectance sees it under a flash."""
    folder = tmp_path_factory.mktemp("captures")
    plain = read_capture(balls.write_capture(folder / "plain", views=10, size=24))
    flash = read_capture(balls.write_capture(folder / "flash", views=10, size=24, flash=50.0))
    return {"texture": plain, "volume": plain, "reflectance": flash}


@pytest.fixture(scope="module")
def answered(tmp_path_factory) -> Patches:
    """Queries that all have one answer."""

    def answers(placing, asked, seed):
        count = len(asked["radius"])
        columns = {
            "alpha": np.ones((count, 1)),
            "cosine": np.zeros((count, 1)),
            "reflectance": np.full((count, 3), 0.1),
        }
        return columns, {}

    folder = tmp_path_factory.mktemp("queries") / "data"
    render_patches(Settings("none", 0.1, (-1.0, 2.0), 512, 1, 0), answers, 3, folder, lambda done, of: None)
    return read_patches(folder)


def taught() -> Exemplars:
    """Two patches of noise."""
    rng = np.random.default_rng(0)
    decoder = decoder_arrays(init_decoder(jax.random.key(0), 4 + 1 + 2, (8,), (8,)))
    about = {"datasets": [{"recipe": "grass"}]}
    features = rng.normal(size=(2, 64, 64, 4)).astype(np.float32)
    return Exemplars(features, rng.normal(size=(8, 4)), np.zeros((2, 0), np.float32), decoder, 1, (), about)


def shrunk(config: Any) -> RunConfig:
    """Two steps of 8² pictures, networks of a few channels."""
    if isinstance(config, NeuTexTrainConfig):
        return replace(config, side=8, samples=4, batch=4, kimg=0.008)
    if isinstance(config, TexturesConfig):  # a critic's window asks for 64 texels
        generator = replace(config.generator, texels=64, channel_base=256, channel_max=4, layers=4)
        critic = replace(config.critic, width=2)
        return replace(config, generator=generator, critic=critic, batch=4, window=64, kimg=0.008)
    if isinstance(config, SurfaceTrainConfig):
        return replace(config, surface=replace(config.surface, texels=8, hidden=(8,)), batch=4, kimg=0.008)
    config = replace(config, picture=replace(config.picture, size=8, samples=4), kimg=0.008)
    if isinstance(config, NerfTexConfig):
        return config
    return replace(
        config,
        generator=replace(
            config.generator, channel_base=2 * config.generator.texels, channel_max=4, channels=4, layers=4
        ),
        discriminator=replace(config.discriminator, size=8, channel_base=32, channel_max=4),
    )


#: What differs from another experiment in a constant, or in a term of the loss or a part of the model, which other tests have;
#: and the plain generator and the captured object, whose runs and steps are tests of their own.
VARIANTS = {
    "carpet",
    "pictures",
    "pictures_fine",
    "smooth",
    "mismatch",
    "frozen_phases",
    "no_fourier",
    "no_mip",
    "atlas_frequency",
    "atlas_no_inverse",
}
VARIANTS |= {
    "atlas",
    "atlas_cloud_first",
    "atlas_no_cloud",
    "textures",
    "textures_critic",
    "textures_patches",
    "weave_cosine",
}
VARIANTS |= {
    "atlas_nerf",
    "atlas_reflectance",
    "spheres_silhouette",
    "triplane",
    "weave_neumip",
    "nerf_tex_seed",
}


@pytest.mark.parametrize(
    "file",
    [pytest.param(f, marks=pytest.mark.slow) if f.stem in VARIANTS else f for f in DISTINCT],
    ids=[f.stem for f in DISTINCT],
)
def test_it_takes_two_steps(file: Path, data, answered, captures, tmp_path: Path) -> None:
    """Everything that learns, and nothing else, has moved, is finite, and is kept as a snapshot with a sheet; the log has all
    losses."""
    config = shrunk(read_experiment(file, "tiny"))
    if isinstance(config, NeuTexTrainConfig):
        data = captures[config.field.colour]
    else:
        data = {SurfaceTrainConfig: answered, TexturesConfig: taught()}.get(type(config), data)
    method = method_of(config)
    state = train(config, data, tmp_path / "run")
    assert int(state.images) == 8 and all(np.isfinite(x).all() for x in jax.tree.leaves(state))
    begin = method.start(*method.adapt(config, data), jax.random.key(config.seed))
    for name, part in method.parts(state).items():
        pairs = zip(jax.tree.leaves(part), jax.tree.leaves(method.parts(begin)[name]), strict=True)
        held = name == "decoder" and getattr(config, "taught", "all") == "plane"
        assert any((np.asarray(a) != np.asarray(b)).any() for a, b in pairs) is not held, name
    row = json.loads((tmp_path / "run" / "log.jsonl").read_text().splitlines()[-1])
    assert row["kimg"] == 0.008 and np.isfinite([row[name] for name in method.losses]).all()
    assert sorted(p.name for p in (tmp_path / "run").glob("s*/*")) == ["000000008.npz", "000000008.png"]


@pytest.mark.slow
@pytest.mark.parametrize("file", DISTINCT, ids=lambda p: p.stem)
def test_it_runs_through_the_tiny_preset(file: Path, larger, answered, captures, tmp_path: Path) -> None:
    config = read_experiment(file, "tiny")
    if isinstance(config, TexturesConfig):
        state = train(config, taught(), tmp_path / "run")
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(state))
        return
    if isinstance(config, NeuTexTrainConfig):
        ball = captures[config.field.colour]
        train(config, ball, tmp_path / "run")
        pictures = method_of(config).load_predictor(
            read_record(tmp_path / "run")[0], snapshots(tmp_path / "run")[-1][1]
        )
        (made,) = pictures([ball.photos[7]])
        others = np.mean([x for i, x in enumerate(ball.rgb) if i != 7], axis=0)
        assert np.abs(made[..., :3] - ball.rgb[7]).mean() < 0.7 * np.abs(others - ball.rgb[7]).mean()
        return
    if isinstance(config, SurfaceTrainConfig):
        train(config, answered, tmp_path / "run")
        answers = method_of(config).load_predictor(read_record(tmp_path / "run")[0], snapshots(tmp_path / "run")[-1][1])
        rho = answers(answered.patches[-1])[2]
        assert abs(rho.mean() - 0.1) < 0.01 and np.abs(rho - 0.1).mean() < 0.02
        return
    state = train(config, larger, tmp_path / "run")
    assert int(state.images) == 240 and all(np.isfinite(x).all() for x in jax.tree.leaves(state))
    pictures = method_of(config).load_predictor(read_record(tmp_path / "run")[0], snapshots(tmp_path / "run")[-1][1])
    config, seen = method_of(config).adapt(config, larger)
    made = pictures(views_of(config, seen, [0, 7]))
    assert made.shape == (2, 16, 16, 4) and np.isfinite(made).all() and made.max() > 0


@pytest.mark.parametrize("file", FILES, ids=lambda p: p.stem)
def test_its_own_size_is_the_small_preset(file: Path) -> None:
    config = read_experiment(file)
    assert isinstance(config, SurfaceTrainConfig | NeuTexTrainConfig | TexturesConfig) or config.picture.size == 64
    assert config == read_experiment(file, "small")
    if not isinstance(config, TexturesConfig):  # whose start needs its data
        jax.eval_shape(lambda: method_of(config).start(config, None, jax.random.key(0)))
    assert file.read_text().startswith('"""')


def test_an_experiment_may_be_about_one_recipe(data, tmp_path: Path) -> None:
    for file in FILES:
        check_recipe(file, experiment_of(file, "tiny")[1], data)
    file = tmp_path / "rug.py"
    file.write_text((Path(__file__).parents[2] / "experiments/carpet.py").read_text() + '\nrecipe = "carpet2"\n')
    recipe = experiment_of(file, "tiny")[1]
    check_recipe(file, recipe, replace(data, recipe="carpet2"))
    with pytest.raises(InputError, match=r"packed: its recipe is fog; rug.py is about carpet2"):
        check_recipe(file, recipe, data)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_comparisons_have_their_presets_pictures_and_length(preset: str) -> None:
    """What is compared sees as many images of the same size, from as near as soon."""
    for file in FILES:
        if file.stem.startswith("nerf_tex"):
            config, ours = read_experiment(file, preset), PRESETS[preset]
            assert isinstance(config, NerfTexConfig) and config.seeded == (file.stem == "nerf_tex_seed")
            for name in ("picture", "batch", "kimg", "near_kimg", "snapshot_kimg"):
                assert getattr(config, name) == getattr(ours, name)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "e.py"
    for text, preset, fault in (
        (
            "config = 3",
            None,
            "defines no `config` that is a GanConfig, a TexturesConfig, a NerfTexConfig, a SurfaceTrainConfig or a NeuT",
        ),
        ("from mesoshell.train.fit.state import FitConfig\nconfig = FitConfig()", None, "defines no `config` that is"),
        ("variant = 3", "small", "defines no `variant`"),
        (
            "",
            "tiny",
            "defines no `variant` that makes of a GanConfig a GanConfig, a TexturesConfig, a NerfTexConfig, a Surf",
        ),
        ("def variant(c): return c.nothing", "tiny", "AttributeError"),
        ("import nothing_of_the_kind", None, "ModuleNotFoundError"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=fault):
            read_experiment(path, preset)
