"""The bundle's arrays: what is written is read, by us and by NumPy alone; a fault is one line, reading and writing."""

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle

SHARED = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

#: key, shape that it is given, shape that the schema says
SHAPES = [
    ("features/0", (4, 8, 2), "(H0, W0, C) = (4, 8, 3)"),
    ("features/0", (4, 8), "(H0, W0, C) = (4, 8, 3)"),
    ("features/0", (0, 8, 3), "(H0, W0, C) = (1, 8, 3)"),
    ("features/1", (2, 3, 3), "(H1, W1, C) = (2, 4, 3)"),
    ("features/3", (1, 2, 3), "(H3, W3, C) = (1, 1, 3)"),
    ("height/0", (5,), "(R0, C) = (5, 3)"),
    ("height/1", (3, 3), "(R1, C) = (2, 3)"),
    ("correction", (3, 2, 3), "(L, B, C) = (4, 2, 3)"),
    ("correction", (4, 2, 2), "(L, B, C) = (4, 2, 3)"),
    ("correction", (4, 0, 3), "(L, B, C) = (4, 1, 3)"),
    ("correction", (4, 3), "(L, B, C) = (4, 3, 3)"),
    ("decoder/trunk/0/kernel", (8, 6), "(T0, T1) = (9, 6)"),
    ("decoder/trunk/0/bias", (5,), "(T1) = (6)"),
    ("decoder/trunk/1/kernel", (7, 5), "(T1, T2) = (6, 5)"),
    ("decoder/sigma/kernel", (5, 3), "(T, 1) = (5, 1)"),
    ("decoder/sigma/bias", (), "(1) = (1)"),
    ("decoder/head/0/kernel", (5, 4), "(S0, S1) = (11, 4)"),
    ("decoder/head/0/bias", (3,), "(S1) = (4)"),
    ("decoder/rho/kernel", (4, 1), "(S, 3) = (4, 3)"),
    ("decoder/rho/bias", (1,), "(3) = (3)"),
    ("sigma_scale", (1,), "() = ()"),
    ("grid/0", (2, 0, 4), "(any, any, any) = (any, any, any)"),
    ("grid/1", (2, 4), "(any, any, any) = (any, any, any)"),
]


@pytest.fixture
def both_faults(tmp_path: Path, bundle: Bundle, fault_of: Callable[..., str]) -> Callable[[dict[str, np.ndarray]], str]:
    """The one fault that these arrays have, on writing and, from a file that NumPy wrote unchecked, on reading."""
    write_bundle(tmp_path / "good.npz", bundle)
    with np.load(tmp_path / "good.npz") as file:
        manifest: Any = {"manifest.json": file["manifest.json"]}

    def both_faults(arrays: dict[str, Any]) -> str:
        fault = fault_of(write_bundle, tmp_path / "a.npz", dataclasses.replace(bundle, arrays=arrays))
        assert [path.name for path in tmp_path.iterdir()] == ["good.npz"]
        np.savez_compressed(tmp_path / "a.npz", **manifest, **arrays)
        assert fault_of(read_bundle, tmp_path / "a.npz") == fault
        (tmp_path / "a.npz").unlink()
        return fault

    return both_faults


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_what_is_written_is_read(tmp_path: Path, bundle: Bundle, dtype: type):
    arrays = {key: array.astype(dtype) for key, array in bundle.arrays.items() if key != "sigma_scale"}
    arrays["sigma_scale"] = bundle.arrays["sigma_scale"]
    write_bundle(tmp_path / "a.npz", dataclasses.replace(bundle, arrays=arrays))
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
    read = read_bundle(tmp_path / "a.npz")
    assert dataclasses.replace(read, arrays={}).__dict__ == dataclasses.replace(bundle, arrays={}).__dict__
    assert read.arrays.keys() == arrays.keys()
    for key, array in read.arrays.items():
        assert array.dtype == arrays[key].dtype and array.flags.writeable
        np.testing.assert_array_equal(array, arrays[key])


def test_numpy_alone_reads_it(tmp_path: Path, bundle: Bundle):
    write_bundle(tmp_path / "a.npz", bundle)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert set(file.files) == {"manifest.json", *bundle.arrays}
        manifest = json.loads(file["manifest.json"].tobytes())
        for key, array in bundle.arrays.items():
            np.testing.assert_array_equal(file[key], array)
    assert manifest["schema"] == 2 and manifest["channels"] == 3 and manifest["height_octaves"] == 2
    length = {"name": "length", "role": "beta", "range": [1.0, 3.0], "default": 2.0, "unit": "cm"}
    assert manifest["parameters"][1] == length | {"meaning": "length of a blade"}


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_what_numpy_alone_writes_is_read(tmp_path: Path, bundle: Bundle, order: Any, save: Callable):
    write_bundle(tmp_path / "a.npz", bundle)
    with np.load(tmp_path / "a.npz") as file:
        save(tmp_path / "b.npz", **{key: np.asarray(file[key], order=order) for key in file.files})
    for key, array in read_bundle(tmp_path / "b.npz").arrays.items():
        np.testing.assert_array_equal(array, bundle.arrays[key])


@SHARED
@given(seed=st.integers(0, 2**32 - 1), order=st.sampled_from("CF"), density=st.floats(1e-3, 1e6))
def test_equal_bundles_are_equal_files(tmp_path: Path, bundle: Bundle, seed: int, order: Any, density: float):
    keys = np.random.default_rng(seed).permutation(sorted(bundle.arrays)).tolist()
    shuffled = {key: np.asarray(bundle.arrays[key], order=order) for key in keys}
    write_bundle(tmp_path / "a.npz", dataclasses.replace(bundle, texel_density=density))
    write_bundle(tmp_path / "b.npz", dataclasses.replace(bundle, texel_density=density, arrays=shuffled))
    write_bundle(tmp_path / "c.npz", read_bundle(tmp_path / "a.npz"))
    first = (tmp_path / "a.npz").read_bytes()
    assert first == (tmp_path / "b.npz").read_bytes() == (tmp_path / "c.npz").read_bytes()


def test_one_texel_and_no_parameters(tmp_path: Path, bundle: Bundle):
    arrays = {key: array for key, array in bundle.arrays.items() if key.startswith(("decoder", "sigma_scale"))}
    arrays["decoder/trunk/0/kernel"] = np.zeros((3 + 1, 6), np.float16)
    arrays |= {"features/0": np.zeros((1, 1, 3), np.float32), "height/0": np.zeros((1, 3), np.float32)}
    arrays |= {"grid/0": np.zeros((1, 1, 1), np.float16)}
    small = dataclasses.replace(bundle, arrays=arrays, parameters=(), provenance={}, height_octaves=0)
    write_bundle(tmp_path / "a.npz", small)
    assert read_bundle(tmp_path / "a.npz").arrays.keys() == arrays.keys()


@SHARED
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_file_cut_anywhere_is_an_input_error(tmp_path: Path, bundle: Bundle, fault_of: Callable, share: float):
    write_bundle(tmp_path / "a.npz", bundle)
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(data[: int(share * len(data))])
    assert fault_of(read_bundle, tmp_path / "a.npz") == "not a zip file, or a truncated or damaged one"


@settings(SHARED, max_examples=150)
@given(share=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255))
def test_a_changed_byte_never_changes_an_array(tmp_path: Path, bundle: Bundle, share: float, value: int):
    write_bundle(tmp_path / "a.npz", bundle)
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[int(share * len(data))] = value
    (tmp_path / "a.npz").write_bytes(data)
    try:
        arrays = read_bundle(tmp_path / "a.npz").arrays
    except InputError as error:
        assert "\n" not in str(error)
    else:
        for key, array in arrays.items():
            np.testing.assert_array_equal(array, bundle.arrays[key])


def test_each_array_is_required(bundle: Bundle, both_faults: Callable):
    for key in bundle.arrays:
        rest = {name: array for name, array in bundle.arrays.items() if name != key}
        last_layer = "unexpected array 'decoder/trunk/1/bias'"  # without its kernel the trunk ends one layer before
        assert both_faults(rest) == (last_layer if key == "decoder/trunk/1/kernel" else f"array {key} is missing")


@pytest.mark.parametrize("key", ["extra", "features/4", "height/3", "grid/4", "decoder/head/2/kernel", "features/00"])
def test_other_arrays_are_refused(bundle: Bundle, both_faults: Callable, key: str):
    assert both_faults(bundle.arrays | {key: np.zeros((4, 4), np.float32)}) == f"unexpected array {key!r}"


@pytest.mark.parametrize(("key", "shape", "expected"), SHAPES)
def test_shapes(bundle: Bundle, both_faults: Callable, key: str, shape: tuple[int, ...], expected: str):
    found = f"({', '.join(map(str, shape))})"
    fault = both_faults(bundle.arrays | {key: np.zeros(shape, np.float32)})
    assert fault == f"array {key} has shape {found}; expected {expected}"


def test_a_texture_of_six_texels_is_refused(bundle: Bundle, both_faults: Callable):
    arrays = {key: array for key, array in bundle.arrays.items() if key not in ("features/3", "grid/3")}
    arrays |= {f"features/{i}": np.zeros((side, 4 >> i, 3), np.float32) for i, side in enumerate([6, 3, 1])}
    assert both_faults(arrays) == "features/0 is 6 × 4 texels; expected powers of two"


@pytest.mark.parametrize("dtype", ["float64", "int16", ">f4", "bool"])
def test_types(bundle: Bundle, both_faults: Callable, dtype: str):
    changed = {"features/0": bundle.arrays["features/0"].astype(dtype)}
    assert both_faults(bundle.arrays | changed) == f"array features/0 holds {dtype}; expected float16 or float32"


def test_sigma_scale_is_single(bundle: Bundle, both_faults: Callable):
    changed = {"sigma_scale": np.array(30, np.float16)}
    assert both_faults(bundle.arrays | changed) == "array sigma_scale holds float16; expected float32"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_are_finite(bundle: Bundle, both_faults: Callable, value: float):
    for key in ("features/2", "height/0", "decoder/rho/bias", "sigma_scale", "grid/3"):
        arrays = {name: array.copy() for name, array in bundle.arrays.items()}
        arrays[key].flat[-1] = value
        assert both_faults(arrays) == f"array {key} has NaN or infinite values"


@pytest.mark.parametrize("key", ["sigma_scale", "grid/2"])
def test_extinction_is_not_negative(bundle: Bundle, both_faults: Callable, key: str):
    assert both_faults(bundle.arrays | {key: -bundle.arrays[key]}) == f"array {key} has negative values"


def test_reading_a_bundle_loads_no_jax():
    program = "import sys, mesoshell.io.bundle; print(sorted({'jax', 'flax', 'optax'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
