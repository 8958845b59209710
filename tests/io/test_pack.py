"""Packed datasets hold what the images held, say where each lies, and every fault of theirs is found."""

import json
import resource
from pathlib import Path

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io import pack
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.dataset_images import load_images, shard_array
from mesoshell.io.pack import pack_dataset


def test_a_packed_dataset_is_the_dataset(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(pack, "_SHARD_BYTES", 2 * 6 * 4 * 8)  # two images a shard
    whole = read_dataset(folder.path)
    assert pack_dataset(whole, tmp_path / "packed") == 3 * 6 * 4 * 8
    packed = read_dataset(tmp_path / "packed")
    np.testing.assert_array_equal(load_images(packed), load_images(whole))
    assert [(s.file.name, s.row) for s in packed.samples] == [("0000.npy", 0), ("0000.npy", 1), ("0001.npy", 0)]
    for a, b in zip(whole.samples, packed.samples, strict=True):
        assert (a.index, a.parameters, a.radius, a.size) == (b.index, b.parameters, b.radius, b.size)
    assert check_dataset(tmp_path / "packed") == []
    assert not list(tmp_path.glob("*.partial"))
    assert shard_array(tmp_path / "packed/shards/0000.npy").shape == (2, 4, 6, 4)


def test_smaller_images_are_means_over_whole_pixels(folder, tmp_path):
    image = np.random.default_rng(0).random((4, 6, 4), np.float32).astype(np.float16).astype(np.float32)
    folder.damage(1, image)
    pack_dataset(read_dataset(folder.path), tmp_path / "packed", 3)
    packed = read_dataset(tmp_path / "packed")
    assert packed.samples[1].size == (3, 2)
    corner = image[:2, :2].astype(np.float64).mean(axis=(0, 1))
    np.testing.assert_allclose(load_images(packed)[1, 0, 0], corner, rtol=2**-11)
    np.testing.assert_allclose(load_images(packed)[1].mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=2**-11)


def test_radiance_beyond_half_precision_stays_finite():
    assert pack._means(np.full((4, 4, 4), 7e4, np.float32), 2).max() == 65504


def test_a_part_of_a_dataset_is_packed_as_a_whole_one(folder, tmp_path):
    folder.manifest(folder.settings | {"count": 9})
    rows = folder.rows.read_text().splitlines(keepends=True)
    folder.rows.write_text(rows[0] + rows[2])
    pack_dataset(read_dataset(folder.path), tmp_path / "packed")
    assert check_dataset(tmp_path / "packed") == []
    assert [sample.index for sample in read_dataset(tmp_path / "packed").samples] == [0, 2]


def test_a_full_disk_leaves_nothing(folder, tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, hard))
    try:
        with pytest.raises(InputError, match=r"0000\.npy: cannot be written: File too large"):
            pack_dataset(read_dataset(folder.path), tmp_path / "packed")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [p.name for p in tmp_path.iterdir()] == ["set"]


@pytest.mark.parametrize("byte", range(0, 128, 3))
def test_a_shard_with_a_wrong_byte_in_its_header_is_a_fault(folder, tmp_path, byte: int):
    pack_dataset(read_dataset(folder.path), tmp_path / "packed")
    shard = tmp_path / "packed/shards/0000.npy"
    data = bytearray(shard.read_bytes())
    data[byte] ^= 0x5B
    shard.write_bytes(data)
    assert isinstance(check_dataset(tmp_path / "packed"), list)


@pytest.mark.parametrize("size", [0, 4, 5, 12])
def test_a_size_that_does_not_divide_is_refused(folder, tmp_path, size: int):
    with pytest.raises(InputError, match=f"size: {size} does not divide the images' 6 × 4 pixels"):
        pack_dataset(read_dataset(folder.path), tmp_path / "packed", size)
    assert not (tmp_path / "packed").exists()


def test_nothing_is_overwritten_or_left_half_written(folder, tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="there: exists already"):
        pack_dataset(read_dataset(folder.path), tmp_path / "there")
    folder.image(2).write_bytes(b"")
    with pytest.raises(InputError, match=r"000002\.exr"):
        pack_dataset(read_dataset(folder.path), tmp_path / "packed")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["set", "there"]


def test_every_fault_of_a_shard_is_found(folder, tmp_path):
    out = tmp_path / "packed"
    pack_dataset(read_dataset(folder.path), out)
    shard = out / "shards/0000.npy"
    images = np.load(shard)
    images[0, 0, 0, 0] = np.nan
    images[1] = 0
    np.save(shard, images)
    rows = (out / "samples.jsonl").read_text().splitlines()
    (out / "samples.jsonl").write_text("\n".join([*rows[:2], json.dumps(json.loads(rows[2]) | {"row": 7})]) + "\n")
    (out / "shards/0009.npy").write_bytes(b"")
    assert check_dataset(out) == [
        f"{shard}[0]: its SHA-256 is not its row's",
        f"{shard}[0]: has NaN or infinite pixels",
        f"{shard}[1]: its SHA-256 is not its row's",
        f"{shard}[1]: is all black",
        f"{shard}: has no row 7",
        f"{out / 'shards/0009.npy'}: has no row in samples.jsonl",
    ]
    shard.write_bytes(shard.read_bytes()[:-9])
    assert check_dataset(out)[0] == f"{shard}: not a NumPy array, or a truncated one"
    np.save(shard, images.astype(np.float32))
    assert check_dataset(out)[0] == f"{shard}: holds float32 of shape (3, 4, 6, 4); expected half images"


def test_two_rows_do_not_share_an_image(folder, tmp_path):
    pack_dataset(read_dataset(folder.path), tmp_path / "packed")
    path = tmp_path / "packed/samples.jsonl"
    path.write_text(path.read_text().replace('"row": 1', '"row": 0'))
    with pytest.raises(InputError, match=r"line 2: file shards/0000\.npy occurs twice"):
        read_dataset(tmp_path / "packed")


def test_a_folder_of_the_users_own_stays(tmp_path: Path, folder):
    (tmp_path / "pp.partial").mkdir()
    (tmp_path / "pp.partial" / "mine").write_bytes(b"mine")
    pack_dataset(read_dataset(folder.path), tmp_path / "pp")
    assert (tmp_path / "pp.partial" / "mine").read_bytes() == b"mine"
