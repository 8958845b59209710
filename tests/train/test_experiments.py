"""Every experiment of the project takes two steps, at the smallest preset; at its own it is a configuration that fits."""

import json
from dataclasses import replace
from pathlib import Path

import fog
import jax
import numpy as np
import pytest

from mesoshell.cli.training import read_experiment
from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.io.pack import pack_dataset
from mesoshell.train.run import train
from mesoshell.train.state import start

FILES = sorted((Path(__file__).parents[2] / "experiments").glob("*.py"))


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Dataset:
    folder = tmp_path_factory.mktemp("data")
    fog.write(folder / "fog", [(0.6, 0.3, 1.6 + 0.4 * k) for k in range(8)], size=8)
    pack_dataset(read_dataset(folder / "fog"), folder / "packed")
    return read_dataset(folder / "packed")


@pytest.mark.parametrize("file", FILES, ids=lambda p: p.stem)
def test_it_takes_two_steps(file: Path, data, tmp_path: Path) -> None:
    tiny = read_experiment(file, "tiny")
    config = replace(
        tiny,
        generator=replace(tiny.generator, channel_base=32, channel_max=4, channels=4, layers=4),
        discriminator=replace(tiny.discriminator, size=8, channel_base=32, channel_max=4),
        picture=replace(tiny.picture, size=8, samples=4),
        kimg=0.008,
    )
    state = train(config, data, tmp_path / "run")
    assert int(state.images) == 8
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(state.smooth))
    row = json.loads((tmp_path / "run" / "log.jsonl").read_text().splitlines()[-1])
    assert row["kimg"] == 0.008


@pytest.mark.parametrize("file", FILES, ids=lambda p: p.stem)
def test_its_own_size_is_the_small_preset(file: Path) -> None:
    config = read_experiment(file)
    assert config.picture.size == 64 and config == read_experiment(file, "small")
    jax.eval_shape(lambda: start(config, jax.random.key(0)))
    assert file.read_text().startswith('"""')


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "e.py"
    for text, preset, fault in (
        ("config = 3", None, "defines no `config` that is a TrainConfig"),
        ("", "tiny", "defines no `variant` that makes one TrainConfig of another"),
        ("def variant(c): return c.nothing", "tiny", "AttributeError"),
        ("import nothing_of_the_kind", None, "ModuleNotFoundError"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=fault):
            read_experiment(path, preset)
