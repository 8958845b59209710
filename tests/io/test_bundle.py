"""The bundle: what is written is read, by us and by NumPy alone; each fault is one line, on reading and on writing."""

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
from mesoshell.io.bundle import Bundle, Parameter, read_bundle, write_bundle

ONE_FOLDER = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
AGE = Parameter("age", "alpha", (0.0, 1.0), 0.25, "", "from fresh to dry")
LENGTH = Parameter("length", "beta", (1.0, 3.0), 2.0, "cm", "length of a blade")


def arrays(channels: int = 3, octaves: int = 2, alpha: int = 1, dtype: type = np.float32) -> dict[str, np.ndarray]:
    """A texture of 4 × 8 texels, 5 rows of height, trunk of widths 6 and 5, head of width 4."""
    shapes: dict[str, tuple[int, ...]] = {
        f"features/{i}": (h, w, channels) for i, (h, w) in enumerate([(4, 8), (2, 4), (1, 2), (1, 1)])
    }
    shapes |= {f"height/{i}": (rows, channels) for i, rows in enumerate([5, 2, 1])}
    shapes |= {f"grid/{i}": (2, 3, 4 - i) for i in range(4)}
    layers = {"trunk/0": (channels + 1 + 2 * octaves + alpha, 6), "trunk/1": (6, 5), "sigma": (5, 1)}
    layers |= {"head/0": (5 + 6, 4), "rho": (4, 3)}
    for name, (inputs, outputs) in layers.items():
        shapes |= {f"decoder/{name}/kernel": (inputs, outputs), f"decoder/{name}/bias": (outputs,)}
    rng = np.random.default_rng(0)
    made = {key: rng.random(shape).astype(dtype) for key, shape in shapes.items()}
    return made | {"sigma_scale": np.array(30, np.float32)}


def bundle(**changes: Any) -> Bundle:
    standard = Bundle(
        kind="shell",
        texel_density=256.0,
        channels=3,
        height_octaves=2,
        parameters=(AGE, LENGTH),
        thickness=0.5,
        colour_space="linear Rec. 709",
        provenance={"config": {"recipe": "grass"}, "metrics": {"psnr": 31.5}},
        arrays=arrays(),
    )
    return dataclasses.replace(standard, **changes)


def manifest_of(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as file:
        return json.loads(file["manifest.json"].tobytes())


def write_raw(path: Path, manifest: Any, members: dict[str, np.ndarray]) -> None:
    """The file as another program would write it, unchecked."""
    text = manifest if isinstance(manifest, bytes) else json.dumps(manifest).encode()
    np.savez_compressed(path, **{"manifest.json": np.frombuffer(text, np.uint8)} | members)  # pyright: ignore


def fault_of(call: Callable, path: Path, *args: Any) -> str:
    """The fault, without the path that it must begin with."""
    with pytest.raises(InputError) as caught:
        call(path, *args)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text
    return text.removeprefix(f"{path}: ")


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_what_is_written_is_read(tmp_path: Path, dtype: type):
    written = bundle(arrays=arrays(dtype=dtype))
    write_bundle(tmp_path / "a.npz", written)
    read = read_bundle(tmp_path / "a.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
    for field in dataclasses.fields(Bundle):
        if field.name != "arrays":
            assert getattr(read, field.name) == getattr(written, field.name)
    assert read.arrays.keys() == written.arrays.keys()
    for key, array in read.arrays.items():
        assert array.dtype == written.arrays[key].dtype and array.flags.writeable
        np.testing.assert_array_equal(array, written.arrays[key])


def test_numpy_alone_reads_it(tmp_path: Path):
    write_bundle(tmp_path / "a.npz", bundle())
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert set(file.files) == {"manifest.json", *arrays()}
        np.testing.assert_array_equal(file["decoder/trunk/1/kernel"], arrays()["decoder/trunk/1/kernel"])
    assert manifest_of(tmp_path / "a.npz")["parameters"][0] == {
        "name": "age",
        "role": "alpha",
        "range": [0.0, 1.0],
        "default": 0.25,
        "unit": "",
        "meaning": "from fresh to dry",
    }


def test_what_numpy_alone_writes_is_read(tmp_path: Path):
    write_bundle(tmp_path / "a.npz", bundle())
    transposed = {key: np.asarray(array, order="F") for key, array in arrays().items()}
    write_raw(tmp_path / "b.npz", manifest_of(tmp_path / "a.npz"), transposed)
    read = read_bundle(tmp_path / "b.npz")
    for key, array in arrays().items():
        np.testing.assert_array_equal(read.arrays[key], array)


@ONE_FOLDER
@given(order=st.permutations(sorted(arrays())), fortran=st.booleans(), density=st.floats(1e-3, 1e6))
def test_equal_bundles_are_equal_files(tmp_path: Path, order: list[str], fortran: bool, density: float):
    shuffled = {key: np.asarray(arrays()[key], order="F" if fortran else "C") for key in order}
    write_bundle(tmp_path / "a.npz", bundle(texel_density=density))
    write_bundle(tmp_path / "b.npz", bundle(texel_density=density, arrays=shuffled))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    write_bundle(tmp_path / "b.npz", read_bundle(tmp_path / "a.npz"))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_grid_of_one_texel_and_no_parameters(tmp_path: Path):
    small = {
        key: array for key, array in arrays(alpha=0).items() if not key.startswith(("features/", "grid/", "height/"))
    }
    small |= {"features/0": np.zeros((1, 1, 3), np.float32), "height/0": np.zeros((1, 3), np.float32)}
    small |= {"grid/0": np.zeros((1, 1, 1), np.float16)}
    write_bundle(tmp_path / "a.npz", bundle(arrays=small, parameters=(), provenance={}))
    assert read_bundle(tmp_path / "a.npz").parameters == ()


def changed(key: str, shape: tuple[int, ...] | None = None, dtype: Any = np.float32) -> dict[str, np.ndarray]:
    """The arrays with one in another shape or type, or (shape None) without it."""
    rest = {name: array for name, array in arrays().items() if name != key}
    return rest if shape is None else rest | {key: np.zeros(shape, dtype)}


def filled(key: str, value: float) -> dict[str, np.ndarray]:
    made = arrays()
    made[key].flat[-1] = value
    return made


def thirds() -> dict[str, np.ndarray]:
    made = {key: array for key, array in arrays().items() if not key.startswith(("features/3", "grid/3"))}
    return made | {f"features/{i}": np.zeros((side, 4 >> i, 3), np.float32) for i, side in enumerate([6, 3, 1])}


ARRAY_FAULTS = [
    *((changed(key), f"array {key} has shape (missing") for key in arrays() if key != "decoder/trunk/1/kernel"),
    (changed("decoder/trunk/1/kernel"), "unexpected array 'decoder/trunk/1/bias'"),
    (changed("extra", (1,)), "unexpected array 'extra'"),
    (changed("features/4", (1, 1, 3)), "unexpected array 'features/4'"),
    (changed("decoder/head/2/kernel", (4, 4)), "unexpected array 'decoder/head/2/kernel'"),
    (changed("features/0", (4, 8, 2)), "array features/0 is 4, 8, 2); expected (H0, W0, C) = (4, 8, 3)"),
    (changed("features/0", (4, 8)), "array features/0 has shape (4, 8); expected (H0, W0, C) = (4, 8, 3)"),
    (changed("features/0", (0, 8, 3)), "array features/0 has shape (0, 8, 3); expected (H0, W0, C) = (1, 8, 3)"),
    (changed("features/1", (2, 3, 3)), "array features/1 has shape (2, 3, 3); expected (H1, W1, C) = (2, 4, 3)"),
    (thirds(), "features/0 is 6 × 4 texels; expected powers of two"),
    (changed("height/1", (3, 3)), "array height/1 has shape (3, 3); expected (R1, C) = (2, 3)"),
    (changed("decoder/trunk/0/kernel", (8, 6)), "array decoder/trunk/0/kernel has shape (8, 6); expected (T0, T1) = (9, 6)"),
    (changed("decoder/trunk/0/bias", (5,)), "array decoder/trunk/0/bias has shape (5); expected (T1) = (6)"),
    (changed("decoder/trunk/1/kernel", (7, 5)), "array decoder/trunk/1/kernel has shape (7, 5); expected (T1, T2) = (6, 5)"),
    (changed("decoder/sigma/kernel", (5, 3)), "array decoder/sigma/kernel has shape (5, 3); expected (T, 1) = (5, 1)"),
    (changed("decoder/head/0/kernel", (5, 4)), "array decoder/head/0/kernel has shape (5, 4); expected (S0, S1) = (11, 4)"),
    (changed("decoder/rho/kernel", (4, 1)), "array decoder/rho/kernel has shape (4, 1); expected (S, 3) = (4, 3)"),
    (changed("sigma_scale", (1,)), "array sigma_scale has shape (1); expected () = ()"),
    (changed("sigma_scale", (), np.float16), "array sigma_scale holds float16; expected float32"),
    (changed("grid/0", (2, 0, 4)), "array grid/0 has shape (2, 0, 4); expected (any, any, any) = (any, any, any)"),
    (changed("grid/1", (2, 4)), "array grid/1 has shape (2, 4); expected (any, any, any) = (any, any, any)"),
    (changed("features/0", (4, 8, 3), np.float64), "array features/0 holds float64; expected float16 or float32"),
    (changed("features/0", (4, 8, 3), np.int16), "array features/0 holds int16; expected float16 or float32"),
    (changed("features/0", (4, 8, 3), ">f4"), "array features/0 holds >f4; expected float16 or float32"),
    (filled("features/2", np.nan), "array features/2 has NaN or infinite values"),
    (filled("decoder/rho/bias", np.inf), "array decoder/rho/bias has NaN or infinite values"),
    (filled("sigma_scale", -1), "array sigma_scale has negative values"),
    (filled("grid/2", -1), "array grid/2 has negative values"),
]


@pytest.mark.parametrize(("members", "fault"), ARRAY_FAULTS, ids=[fault for _, fault in ARRAY_FAULTS])
def test_faults_of_arrays(tmp_path: Path, members: dict[str, np.ndarray], fault: str):
    write_bundle(tmp_path / "good.npz", bundle())
    assert fault_of(write_bundle, tmp_path / "a.npz", bundle(arrays=members)) == fault
    assert not (tmp_path / "a.npz").exists()
    write_raw(tmp_path / "a.npz", manifest_of(tmp_path / "good.npz"), members)
    assert fault_of(read_bundle, tmp_path / "a.npz") == fault


def edited(**changes: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda manifest: manifest | changes


def without(name: str) -> Callable[[dict[str, Any]], Any]:
    return lambda manifest: {key: value for key, value in manifest.items() if key != name}


def first_parameter(**changes: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda manifest: manifest | {"parameters": [manifest["parameters"][0] | changes, manifest["parameters"][1]]}


MANIFEST_FAULTS = [
    (lambda _: b"{", "manifest.json is not JSON: Expecting property name enclosed in double quotes: "),
    (lambda _: b"\xff", "manifest.json is not JSON: 'utf-8' codec can't decode byte 0xff"),
    (lambda _: b"[" * 100_000, "manifest.json is not JSON: maximum recursion depth exceeded"),
    (lambda _: [1], "manifest.json is not a JSON object"),
    *((without(name), f"manifest.json: field {name!r} is missing") for name in manifest_fields()),
    (edited(extra=1), "manifest.json: unexpected field 'extra'"),
    (edited(schema=2), "manifest.json: schema is 2; expected 1"),
    (edited(kind="hair"), "manifest.json: kind is 'hair'; expected 'shell'"),
    (edited(texel_density=0), "manifest.json: texel_density is 0; expected a number above 0"),
    (edited(texel_density=float("nan")), "manifest.json: texel_density is nan; expected a number above 0"),
    (edited(texel_density=10**400), "manifest.json: texel_density is 1000"),
    (edited(thickness="1"), "manifest.json: thickness is '1'; expected a number above 0"),
    (edited(channels=3.0), "manifest.json: channels is 3.0; expected an integer, 1 or more"),
    (edited(channels=True), "manifest.json: channels is True; expected an integer, 1 or more"),
    (edited(height_octaves=-1), "manifest.json: height_octaves is -1; expected an integer, 0 or more"),
    (edited(parameters={}), "manifest.json: parameters is {}; expected a list"),
    (edited(parameters=[1]), "manifest.json: parameter 0 is not a JSON object"),
    (edited(colour_space="sRGB"), "manifest.json: colour_space is 'sRGB'; expected 'linear Rec. 709'"),
    (edited(provenance=[]), "manifest.json: provenance is []; expected an object"),
    (first_parameter(name=1), "manifest.json: parameter 0: name is 1; expected text"),
    (first_parameter(name="length"), "manifest.json: two parameters of one name in ['length', 'length']"),
    (first_parameter(role="gamma"), "manifest.json: parameter 0: role is 'gamma'; expected 'alpha' or 'beta'"),
    (first_parameter(role="beta"), "array decoder/trunk/0/kernel has shape (9, 6); expected (T0, T1) = (8, 6)"),
    (first_parameter(range=[1, 1]), "manifest.json: parameter 0: range is [1, 1]; expected [lo, hi] with lo < hi"),
    (first_parameter(range=[0]), "manifest.json: parameter 0: range is [0]; expected [lo, hi] with lo < hi"),
    (first_parameter(default=1.5), "manifest.json: parameter 0: default 1.5 is outside its range 0.0 to 1.0"),
    (first_parameter(default=None), "manifest.json: parameter 0: default is None; expected a number"),
    (first_parameter(unit=None), "manifest.json: parameter 0: unit is None; expected text"),
    (first_parameter(meaning=0), "manifest.json: parameter 0: meaning is 0; expected text"),
    (first_parameter(extra=0), "manifest.json: parameter 0: unexpected field 'extra'"),
    (lambda m: m | {"parameters": [{"name": "age"}]}, "manifest.json: parameter 0: field 'role' is missing"),
]


@pytest.mark.parametrize(("edit", "fault"), MANIFEST_FAULTS, ids=[fault for _, fault in MANIFEST_FAULTS])
def test_faults_of_the_manifest(tmp_path: Path, edit: Callable, fault: str):
    write_bundle(tmp_path / "a.npz", bundle())
    write_raw(tmp_path / "a.npz", edit(manifest_of(tmp_path / "a.npz")), arrays())
    assert fault_of(read_bundle, tmp_path / "a.npz").startswith(fault)


WRITE_FAULTS = [
    ({"thickness": float("nan")}, "cannot be written: manifest.json is not JSON: Out of range float values"),
    ({"provenance": {"path": Path("a")}}, "cannot be written: manifest.json is not JSON: Object of type"),
    ({"kind": "hair"}, "manifest.json: kind is 'hair'; expected 'shell'"),
    ({"channels": 2}, "array decoder/trunk/0/kernel has shape (9, 6); expected (T0, T1) = (8, 6)"),
    ({"height_octaves": 3}, "array decoder/trunk/0/kernel has shape (9, 6); expected (T0, T1) = (11, 6)"),
    ({"parameters": (AGE, AGE)}, "manifest.json: two parameters of one name in ['age', 'age']"),
    ({"parameters": (dataclasses.replace(AGE, default=2.0),)}, "manifest.json: parameter 0: default 2.0 is outside"),
]
