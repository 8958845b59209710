"""Batches of a packed dataset: every sample once a pass, disjoint over hosts, the same at a step however it is reached."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.train.loader import Feed
from tests.helpers import fog

N = 12
PARAMETERS = {
    "hue": {"role": "alpha", "range": [0, 1], "default": 0.5, "unit": "", "meaning": ""},
    "length": {"role": "beta", "range": [2, 4], "default": 3, "unit": "", "meaning": ""},
    "lean": {"role": "beta", "range": [-1, 1], "default": 0, "unit": "", "meaning": ""},
}


@pytest.fixture
def packed(tmp_path: Path) -> Dataset:
    """Image i is i / 16 everywhere."""
    (tmp_path / "shards").mkdir()
    images = np.broadcast_to((np.arange(N, dtype=np.float16) / 16)[:, None, None, None], (N, 2, 2, 4))
    np.save(tmp_path / "shards/0000.npy", images[:7])
    np.save(tmp_path / "shards/0001.npy", images[7:])
    manifest = {"schema": 1, "alpha": "premultiplied", "recipe": "x", "version": 1, "field_of_view": 0.4}
    manifest |= {"parameters": PARAMETERS, "radius_range": [1, 2], "size": [2, 2], "samples_per_pixel": 1, "seed": 0}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest | {"count": N}))
    rows = [
        {"index": i, "file": f"shards/000{i // 7}.npy", "row": i % 7, "sha256": "0" * 64, "seed": 0, "size": [2, 2]}
        | {"parameters": {"hue": i / N, "length": 2 + 2 * i / N, "lean": -1.0}, "camera_to_world": np.eye(4).tolist()}
        | {"fov": 0.4, "radius": 1.5, "light": [0, 0, 1], "irradiance": [i, 1, 1]}
        for i in range(N)
    ]
    (tmp_path / "samples.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return read_dataset(tmp_path)


def test_all_of_a_sample_stays_together(packed):
    batch = Feed(packed, 5)[0]
    index = batch.index
    np.testing.assert_array_equal(batch.image, np.broadcast_to((index / 16)[:, None, None, None], (5, 2, 2, 4)))
    np.testing.assert_allclose(batch.alpha, (index / N)[:, None], rtol=1e-6)
    np.testing.assert_allclose(batch.beta, np.stack([index / N, 0 * index], axis=1), rtol=1e-6)
    np.testing.assert_array_equal(batch.irradiance[:, 0], index)
    assert batch.image.dtype == np.float16 and batch.alpha.dtype == np.float32


def test_every_sample_once_a_pass_and_another_order_each_time(packed):
    feed = Feed(packed, 4)
    passes = [np.concatenate([feed[3 * p + i].index for i in range(3)]) for p in range(3)]
    assert all(sorted(order) == list(range(N)) for order in passes)
    assert len({tuple(order) for order in passes}) == 3
    assert not np.array_equal(Feed(packed, N, seed=1)[0].index, Feed(packed, N, seed=0)[0].index)


@pytest.mark.parametrize("hosts", [2, 3])
def test_hosts_share_a_pass(packed, hosts: int):
    feeds = [Feed(packed, N // hosts, seed=4, host=host, hosts=hosts) for host in range(hosts)]
    assert sorted(np.concatenate([feed[0].index for feed in feeds])) == list(range(N))


@pytest.mark.parametrize("hosts", [2, 3])
def test_hosts_have_the_rows_of_one_host_in_its_order(packed, hosts: int):
    """Keys, groups and views belong to a row's place: another order would be another run."""
    feeds = [Feed(packed, 2, seed=4, host=host, hosts=hosts) for host in range(hosts)]
    alone = Feed(packed, 2 * hosts, seed=4)
    for step in (0, 2, 5):
        np.testing.assert_array_equal(np.concatenate([feed[step].index for feed in feeds]), alone[step].index)


@pytest.mark.parametrize("step", [0, 1, 7])
def test_restarted_at_a_step_it_goes_on_the_same(packed, step: int):
    feed = Feed(packed, 5, seed=2)
    straight = [feed[i] for i in range(step + 6)][step:]
    again = list(itertools.islice(Feed(packed, 5, seed=2).after(step), 6))
    for a, b in zip(straight, again, strict=True):
        for x, y in zip(a, b, strict=True):
            np.testing.assert_array_equal(x, y)


def test_a_batch_may_exceed_a_pass(packed):
    assert sorted(Feed(packed, 2 * N)[0].index) == sorted([*range(N), *range(N)])


def test_what_cannot_be_fed(packed, tmp_path: Path):
    with pytest.raises(InputError, match="is not packed; pack it with: mesoshell dataset pack"):
        Feed(fog.write(tmp_path / "fog", fog.CAMERAS[:1]), 2)
    with pytest.raises(InputError, match="has 12 samples for 13 hosts"):
        Feed(packed, 1, host=0, hosts=13)
    with pytest.raises(ValueError, match="host 2 of 2"):
        Feed(packed, 1, host=2, hosts=2)
