"""A bundle's features on the device: those of a folder are the mapped file's own memory, on a CPU."""

from pathlib import Path

import jax
import numpy as np

from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.kept_textures import in_folder, to_folder
from mesoshell.shell.material.loader import load_device_material


def _in_folder(folder: Path, bundle: Bundle) -> Bundle:
    def make(allocate) -> Bundle:
        levels = [array for key, array in bundle.arrays.items() if key.startswith("features/")]
        for new, level in zip(allocate("features", [x.shape for x in levels]), levels, strict=True):
            new[:] = level
        return bundle

    folder.mkdir()
    to_folder(folder, make)
    return read_bundle(folder)


def test_a_folder_is_not_copied(tiny_bundle: Bundle, tmp_path: Path):
    mapped = _in_folder(tmp_path / "a", tiny_bundle)
    assert not (tmp_path / "a" / "features").exists()
    found, expected = load_device_material(mapped), load_device_material(tiny_bundle)
    np.testing.assert_array_equal(found.material.texture.rows, expected.material.texture.rows)
    assert found.layout == expected.layout
    if jax.default_backend() == "cpu":
        first = mapped.arrays["features/0"].__array_interface__["data"][0]
        assert found.material.texture.rows.unsafe_buffer_pointer() == first


def test_levels_of_files_of_their_own_are_read_too(tiny_bundle: Bundle, tmp_path: Path):
    """As folders had them before."""
    mapped = _in_folder(tmp_path / "a", tiny_bundle)
    (tmp_path / "a" / "features").mkdir()
    for i in range(sum(key.startswith("features/") for key in mapped.arrays)):
        np.save(tmp_path / "a" / "features" / f"{i}.npy", mapped.arrays[f"features/{i}"])
    for name in ("features.npy", "features.json"):
        (tmp_path / "a" / name).unlink()
    found = read_bundle(tmp_path / "a")
    assert found.arrays.keys() == mapped.arrays.keys()
    np.testing.assert_array_equal(
        load_device_material(found).material.texture.rows, load_device_material(mapped).material.texture.rows
    )


def test_what_is_allocated_is_zero(tmp_path: Path):
    first, second = in_folder(tmp_path)("a", [(2, 3), (4,)])
    assert first.dtype == np.float16 and not first.any() and not second.any() and second.shape == (4,)
