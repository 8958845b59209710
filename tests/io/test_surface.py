"""A surface material's file: what is written is read, by us and by NumPy alone; each fault is one line that names the file."""

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
from mesoshell.io.surface import SurfaceBundle, kind_of, read_surface, write_surface
from tests.helpers import wearing

SHARED = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
FIELDS = {f.name for f in dataclasses.fields(SurfaceBundle)} - {"arrays"} | {"schema", "kind", "colour_space"}

#: field, what it cannot be
WRONG: list[tuple[str, Any]] = [
    ("schema", 1),
    ("schema", None),
    ("kind", "shell"),
    ("colour_space", "sRGB"),
    ("texels", 0),
    ("texels", -8),
    ("texels", 6),
    ("texels", 8.0),
    ("texels", True),
    ("texels", "8"),
    ("channels", 0),
    ("channels", 3.0),
    ("channels", None),
    ("opacity", "half"),
    ("opacity", 1),
    ("opacity", None),
    ("step", 0),
    ("step", -0.1),
    ("step", "0.1"),
    ("step", float("nan")),
    ("step", True),
    ("offset", None),
    ("offset", float("inf")),
    ("offset", [0.1]),
    ("sees_curvature", 1),
    ("sees_curvature", "yes"),
    ("curvature", [1.0, 1.0]),
    ("curvature", [2.0, -1.0]),
    ("curvature", [0.0, float("nan")]),
    ("curvature", [0.0]),
    ("curvature", [0.0, 1.0, 2.0]),
    ("curvature", {"0": 1, "1": 2}),
    ("curvature", 3),
    ("curvature", ["0", "1"]),
    ("depth", 0),
    ("depth", -1),
    ("depth", float("inf")),
    ("depth", "deep"),
    ("provenance", None),
    ("provenance", []),
]

#: array, the shape that it is given, the shape that there must be
SHAPES = [
    ("opacity/texture/0", (8, 4, 3), (8, 8, 3)),
    ("opacity/texture/0", (8, 8), (8, 8, 3)),
    ("offset/texture/2", (2, 2, 4), (2, 2, 3)),
    ("reflectance/texture/3", (1, 3), (1, 1, 3)),
    ("opacity/hidden/0/kernel", (6, 8), (7, 8)),
    ("opacity/hidden/0/bias", (7,), (8,)),
    ("offset/hidden/0/bias", (), (8,)),
    ("offset/last/kernel", (8, 2), (8, 1)),
    ("offset/last/bias", (3,), (1,)),
    ("reflectance/hidden/0/kernel", (7, 8), (10, 8)),
    ("reflectance/last/kernel", (8, 1), (8, 3)),
    ("reflectance/last/kernel", (7, 3), (8, 3)),
]


@pytest.fixture(scope="module")
def made() -> SurfaceBundle:
    return wearing.bundle(provenance={"config": {"batch": 4}, "dataset": {"source": "weave"}})


def manifest_of(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return json.loads(file["manifest.json"].tobytes())


def save(path: Path, manifest: Any, arrays: dict[str, np.ndarray]) -> Path:
    """A file as NumPy writes it, unchecked."""
    text = manifest if isinstance(manifest, bytes) else json.dumps(manifest).encode()
    np.savez(path, **{"manifest.json": np.frombuffer(text, np.uint8)}, **arrays)  # type: ignore[arg-type]
    return path


@pytest.fixture
def fault(tmp_path: Path, made: SurfaceBundle, fault_of: Callable[..., str]) -> Callable[..., str]:
    """The fault of a file with this manifest, or these of its fields, and these arrays."""
    write_surface(tmp_path / "good.npz", made)
    good = manifest_of(tmp_path / "good.npz")

    def fault(fields: Any = None, arrays: dict[str, np.ndarray] | None = None) -> str:
        manifest = good | (fields or {}) if isinstance(fields, dict | None) else fields
        path = save(tmp_path / "a.npz", manifest, made.arrays if arrays is None else arrays)
        return fault_of(read_surface, path)

    return fault


def test_what_is_written_is_read(tmp_path: Path, made: SurfaceBundle) -> None:
    write_surface(tmp_path / "a.npz", made)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
    read = read_surface(tmp_path / "a.npz")
    assert dataclasses.replace(read, arrays={}).__dict__ == dataclasses.replace(made, arrays={}).__dict__
    assert read.arrays.keys() == made.arrays.keys()
    for key, array in read.arrays.items():
        assert array.dtype == made.arrays[key].dtype
        np.testing.assert_array_equal(array, made.arrays[key])


@pytest.mark.parametrize(
    "sizes",
    [
        {"texels": 1, "channels": 1},
        {"texels": 2, "hidden": (4, 5, 6)},
        {"opacity": "cosine", "sees_curvature": False, "offset": -0.2},
        {"opacity": "none", "curvature": (-3.0, -1.5), "step": 1.0},
    ],
)
def test_other_sizes_and_forms_are_read(tmp_path: Path, sizes: dict[str, Any]) -> None:
    b = wearing.bundle(**sizes)
    write_surface(tmp_path / "a.npz", b)
    read = read_surface(tmp_path / "a.npz")
    assert dataclasses.replace(read, arrays={}).__dict__ == dataclasses.replace(b, arrays={}).__dict__
    assert read.arrays.keys() == b.arrays.keys()


def test_numpy_alone_reads_it(tmp_path: Path, made: SurfaceBundle) -> None:
    write_surface(tmp_path / "a.npz", made)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert set(file.files) == {"manifest.json", *made.arrays}
        for key, array in made.arrays.items():
            np.testing.assert_array_equal(file[key], array)
    manifest = manifest_of(tmp_path / "a.npz")
    assert manifest.keys() == FIELDS
    assert (manifest["schema"], manifest["kind"], manifest["texels"], manifest["curvature"]) == (
        2,
        "silhouette",
        8,
        [-1, 2],
    )


def test_textures_are_in_half_precision_and_networks_are_not(fault: Callable[..., str], made: SurfaceBundle) -> None:
    for key, kind in (
        ("offset/texture/1", np.float32),
        ("offset/last/bias", np.float16),
        ("offset/last/kernel", np.float64),
    ):
        array = made.arrays[key].astype(kind)
        said = f"array {key} is {array.dtype} of shape {array.shape}; expected shape {array.shape}"
        assert fault(arrays=made.arrays | {key: array}) == said
    swapped = {"opacity/texture/0": made.arrays["opacity/texture/0"].astype(">f2")}
    assert "opacity/texture/0 is >f2" in fault(arrays=made.arrays | swapped)


def test_equal_bundles_are_equal_files(tmp_path: Path, made: SurfaceBundle) -> None:
    """Whatever the order of their arrays, and in memory."""
    keys = np.random.default_rng(0).permutation(sorted(made.arrays)).tolist()
    shuffled = {key: np.asarray(made.arrays[key], order="F") for key in keys}
    write_surface(tmp_path / "a.npz", made)
    write_surface(tmp_path / "b.npz", dataclasses.replace(made, arrays=shuffled))
    write_surface(tmp_path / "c.npz", read_surface(tmp_path / "a.npz"))
    first = (tmp_path / "a.npz").read_bytes()
    assert first == (tmp_path / "b.npz").read_bytes() == (tmp_path / "c.npz").read_bytes()
    write_surface(tmp_path / "b.npz", dataclasses.replace(made, step=0.02))
    assert first != (tmp_path / "b.npz").read_bytes()


def test_kinds_are_told_apart(
    tmp_path: Path, made: SurfaceBundle, bundle: Bundle, fault_of: Callable[..., str]
) -> None:
    """And a reader of the other kind says so in a line."""
    write_surface(tmp_path / "surface.npz", made)
    write_bundle(tmp_path / "shell.npz", bundle)
    assert kind_of(tmp_path / "surface.npz") == "silhouette" and kind_of(tmp_path / "shell.npz") == "shell"
    assert fault_of(read_surface, tmp_path / "shell.npz") == "manifest.json: kind is not 'silhouette'"
    assert "manifest.json" in fault_of(read_bundle, tmp_path / "surface.npz")


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_every_field_is_checked(fault: Callable[..., str], name: str, value: Any) -> None:
    said = fault({name: value})
    assert said.startswith(f"manifest.json: {name} is ")


def test_every_field_is_required_and_no_other_is_allowed(fault: Callable[..., str], tmp_path: Path) -> None:
    good = manifest_of(tmp_path / "good.npz")
    for name in FIELDS:
        manifest = json.dumps({k: v for k, v in good.items() if k != name}).encode()
        said = fault(manifest)
        assert said.startswith(
            f"manifest.json: {name} is not "
            if name in ("schema", "kind", "colour_space")
            else "manifest.json: its fields are not "
        ), name
    assert fault({"more": 1}).startswith("manifest.json: its fields are not channels, curvature, ")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"", "manifest.json is not JSON"),
        (b"{", "manifest.json is not JSON"),
        (b"\xff\xfe{}", "manifest.json is not JSON"),
        (b"[]", "manifest.json is not a JSON object"),
        (b"null", "manifest.json is not a JSON object"),
    ],
)
def test_a_manifest_that_is_none(fault: Callable[..., str], tmp_path: Path, fault_of, text: bytes, said: str) -> None:
    assert fault(text).startswith(said)
    assert fault_of(kind_of, tmp_path / "a.npz").startswith(said)


def test_files_that_are_no_bundles(tmp_path: Path, made: SurfaceBundle, fault_of: Callable[..., str]) -> None:
    np.savez(tmp_path / "none.npz", a=np.zeros(3))
    np.savez(tmp_path / "kind.npz", **{"manifest.json": np.zeros(3)})  # type: ignore[arg-type]
    (tmp_path / "text.npz").write_text("hello")
    for read in (read_surface, kind_of):
        for name in ("none.npz", "kind.npz"):
            assert fault_of(read, tmp_path / name) == "has no manifest.json of type uint8: not a bundle"
        assert fault_of(read, tmp_path / "text.npz") == "not a zip file, or a truncated or damaged one"
        assert fault_of(read, tmp_path / "nothing.npz") == "no such file"
    (tmp_path / "file").write_text("")
    fault_of(write_surface, tmp_path / "file" / "a.npz", made)


def test_each_array_is_required(fault: Callable[..., str], made: SurfaceBundle) -> None:
    for key in made.arrays:
        rest = {name: array for name, array in made.arrays.items() if name != key}
        assert fault(arrays=rest) == f"array {key} is missing"


@pytest.mark.parametrize(
    "key", ["extra", "opacity/texture/4", "opacity/hidden/2/kernel", "opacity/hidden/1/bias", "gloss/last/bias"]
)
def test_other_arrays_are_refused(fault: Callable[..., str], made: SurfaceBundle, key: str) -> None:
    assert fault(arrays=made.arrays | {key: np.zeros((4, 4), np.float32)}) == f"unexpected array {key!r}"


@pytest.mark.parametrize(("key", "shape", "wanted"), SHAPES)
def test_shapes(fault: Callable[..., str], made: SurfaceBundle, key: str, shape: tuple, wanted: tuple) -> None:
    array = np.zeros(shape, made.arrays[key].dtype)
    said = f"array {key} is {array.dtype} of shape {shape}; expected shape {wanted}"
    assert fault(arrays=made.arrays | {key: array}) == said


def test_layers_must_fit_each_other(fault: Callable[..., str], made: SurfaceBundle) -> None:
    """A hidden layer of another width needs a bias and a next layer of that width; one of no width is none."""
    for width in (5, 0):
        kernel = {"offset/hidden/0/kernel": np.zeros((7, width), np.float32)}
        assert fault(arrays=made.arrays | kernel).startswith("array offset/")
    shapes = {"hidden/0/kernel": (7, 0), "hidden/0/bias": (0,), "last/kernel": (0, 1)}
    empty = {f"offset/{k}": np.zeros(shape, np.float32) for k, shape in shapes.items()}
    assert fault(arrays=made.arrays | empty).startswith("array offset/")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_are_finite(fault: Callable[..., str], made: SurfaceBundle, value: float) -> None:
    for key in ("opacity/texture/2", "offset/hidden/0/kernel", "reflectance/last/bias"):
        array = made.arrays[key].copy()
        array.flat[-1] = value
        assert fault(arrays=made.arrays | {key: array}) == f"array {key} has NaN or infinite values"


@SHARED
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_file_cut_anywhere_is_an_input_error(
    tmp_path: Path, made: SurfaceBundle, fault_of: Callable, share: float
) -> None:
    write_surface(tmp_path / "a.npz", made)
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(data[: int(share * len(data))])
    assert fault_of(read_surface, tmp_path / "a.npz") == "not a zip file, or a truncated or damaged one"


@settings(SHARED, max_examples=150)
@given(share=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255))
def test_a_changed_byte_never_changes_an_array(tmp_path: Path, made: SurfaceBundle, share: float, value: int) -> None:
    write_surface(tmp_path / "a.npz", made)
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[int(share * len(data))] = value
    (tmp_path / "a.npz").write_bytes(data)
    try:
        arrays = read_surface(tmp_path / "a.npz").arrays
    except InputError as error:
        assert "\n" not in str(error) and str(tmp_path / "a.npz") in str(error)
    else:
        for key, array in arrays.items():
            np.testing.assert_array_equal(array, made.arrays[key])


def test_reading_loads_no_jax() -> None:
    program = "import sys, mesoshell.io.surface; print(sorted({'jax', 'flax', 'optax'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
