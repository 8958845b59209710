"""Reading of a dataset folder: a good one comes back, and every fault is one line with its file and line number."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.dataset_images import load_images

AGE = {"role": "alpha", "range": [0, 1], "default": 0.5, "unit": "", "meaning": "dryness"}


def fault_of(call: Callable, argument: Any) -> str:
    """The whole line: a dataset's fault names a file of the folder."""
    with pytest.raises(InputError) as caught:
        call(argument)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_good_dataset_is_read_in_order_of_index(folder):
    folder.write(folder.read_rows()[::-1])
    dataset = read_dataset(folder.path)
    assert (dataset.folder, dataset.recipe, dataset.manifest) == (folder.path, "grass", folder.settings)
    assert [sample.index for sample in dataset.samples] == [0, 1, 2]
    sample = dataset.samples[1]
    assert sample.file == folder.image(1) and sample.parameters == {"age": 0.25} and sample.size == (6, 4)
    assert sample.fov == 0.6 and sample.radius == 2.5
    np.testing.assert_array_equal(sample.camera_to_world, np.eye(4))
    np.testing.assert_array_equal(sample.light, [0.6, 0, 0.8])
    np.testing.assert_array_equal(sample.irradiance, [1.0, 2.0, 3.0])
    images = load_images(dataset)
    assert images.shape == (3, 4, 6, 4) and images.dtype == np.float32
    np.testing.assert_array_equal(images[:, 0, 0, 0], [0.125, 0.25, 0.375])
    assert check_dataset(folder.path) == []


def test_blank_lines_and_fields_of_later_versions_are_passed_over(folder):
    folder.manifest(folder.settings | {"pixel_filter": "box"})
    folder.change_row(0, {"exposure": 1})
    folder.rows.write_text("\n" + folder.rows.read_text() + "\n")
    assert len(read_dataset(folder.path).samples) == 3


def test_missing_folder_and_files(folder, tmp_path: Path):
    assert fault_of(read_dataset, tmp_path / "none") == f"{tmp_path / 'none'}: no such folder"
    folder.rows.unlink()
    assert fault_of(read_dataset, folder.path) == f"{folder.rows}: no such file"
    assert check_dataset(folder.path) == [f"{folder.rows}: no such file"]
    folder.manifest_file.unlink()
    assert fault_of(read_dataset, folder.path) == f"{folder.manifest_file}: no such file"
    assert check_dataset(folder.path) == [f"{folder.manifest_file}: no such file"]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (b'{\n "schema": 1,\n "recipe": }', "line 3: not JSON: Expecting value"),
        (b"", "line 1: not JSON: Expecting value"),
        (b"[" * 100_000, "line 1: not JSON: maximum recursion depth exceeded"),
        (b"[]", "is not a JSON object"),
        (b"\xff", "is not UTF-8 text"),
    ],
)
def test_manifest_text(folder, text: bytes, fault: str):
    folder.manifest_file.write_bytes(text)
    assert fault_of(read_dataset, folder.path).startswith(f"{folder.manifest_file}: {fault}")


def test_each_field_of_the_manifest_is_required(folder):
    known = {"schema": "schema is None; expected 1", "alpha": "alpha is None; expected 'premultiplied'"}
    for name in folder.settings:
        folder.manifest({key: value for key, value in folder.settings.items() if key != name})
        fault = known.get(name, f"field {name!r} is missing")
        assert fault_of(read_dataset, folder.path) == f"{folder.manifest_file}: {fault}"


@pytest.mark.parametrize(
    ("fields", "fault"),
    [
        ({"schema": 2}, "schema is 2; expected 1"),
        ({"alpha": "straight"}, "alpha is 'straight'; expected 'premultiplied'"),
        ({"recipe": 5}, "recipe is 5; expected str"),
        ({"count": "3"}, "count is '3'; expected int"),
        ({"size": 6}, "size is 6; expected list"),
        ({"parameters": {"age": {}}}, "parameter 'age' must have role, range, default, unit, meaning"),
        ({"parameters": {"age": AGE | {"range": "01"}}}, "parameter 'age': range is '01'; expected [lo, hi]"),
        ({"parameters": {"age": AGE | {"range": [0]}}}, "parameter 'age': range is [0]; expected [lo, hi]"),
        ({"parameters": {"age": AGE | {"range": [1, 1]}}}, "parameter 'age': range is [1, 1]; expected [lo, hi] with"),
    ],
)
def test_fields_of_the_manifest(folder, fields: dict[str, Any], fault: str):
    folder.manifest(folder.settings | fields)
    assert fault_of(read_dataset, folder.path).startswith(f"{folder.manifest_file}: {fault}")


@pytest.mark.parametrize("line", ['{"index": 1', "x", "[" * 100_000, "", "7"])
def test_a_bad_row_is_named_by_its_line(folder, line: str):
    lines = folder.rows.read_text().split("\n")
    folder.rows.write_text("\n".join([lines[0], line, *lines[2:]]))
    if line:
        fault = "is not a JSON object" if line == "7" else "not JSON: "
        assert fault_of(read_dataset, folder.path).startswith(f"{folder.rows}: line 2: {fault}")
    else:
        assert [sample.index for sample in read_dataset(folder.path).samples] == [0, 2]


def test_each_field_of_a_row_is_required(folder):
    rows = folder.read_rows()
    for name in rows[1]:
        folder.write([rows[0], {key: value for key, value in rows[1].items() if key != name}])
        assert fault_of(read_dataset, folder.path) == f"{folder.rows}: line 2: field {name!r} is missing"


@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        ("index", -1, "index is -1; expected a whole number, 0 or more"),
        ("index", True, "index is True; expected a whole number, 0 or more"),
        ("index", 0, "index 0 occurs twice"),
        ("file", "images/000000.exr", "file images/000000.exr occurs twice"),
        ("file", "images/../../a.exr", "file is 'images/../../a.exr'; expected images/NAME"),
        ("sha256", "abc", "sha256 is 'abc'; expected 64 hex digits"),
        ("seed", "7", "seed is '7'; expected a number"),
        ("instance", "7", "instance is '7'; expected a whole number, 0 or more"),
        ("size", [6, 4.5], "size is [6, 4.5]; expected [W, H] in whole pixels"),
        ("size", [4, 6], "size is [4, 6]; the manifest says [6, 4]"),
        ("parameters", {"age": 1.5}, "parameter 'age' is 1.5; expected 0 to 1"),
        ("parameters", {"age": -0.5}, "parameter 'age' is -0.5; expected 0 to 1"),
        ("parameters", {"age": "1"}, "parameter 'age' is '1'; expected 0 to 1"),
        ("parameters", {}, "parameters are {}; the manifest declares ['age']"),
        ("camera_to_world", [[1, 0], [0]], "camera_to_world is [[1, 0], [0]]; expected 4 × 4 numbers that end in "),
        ("camera_to_world", np.eye(4)[::-1].tolist(), "camera_to_world is [[0.0, 0.0, 0.0, 1.0], "),
        ("fov", 4, "fov is 4; expected an angle between 0 and π"),
        ("radius", 0, "radius is 0; expected a number above 0"),
        ("radius", float("nan"), "radius is nan; expected a number above 0"),
        ("light", [0, 0, 2], "light is [0, 0, 2]; expected a unit vector"),
        ("irradiance", [1, 1, -1], "irradiance is [1, 1, -1]; expected three numbers, 0 or more"),
        ("irradiance", 1, "irradiance is 1; expected three numbers, 0 or more"),
    ],
)
def test_fields_of_a_row(folder, name: str, value: Any, fault: str):
    folder.change_row(1, {name: value})
    assert fault_of(read_dataset, folder.path).startswith(f"{folder.rows}: line 2: {fault}")
    assert check_dataset(folder.path)[0].startswith(f"{folder.rows}: line 2: {fault}")
