"""The bundle's manifest: every field is required and checked, on reading and on writing."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mesoshell.io.bundle import Bundle, Parameter, read_bundle, write_bundle

AGE = Parameter("age", "alpha", (0.0, 1.0), 0.25, "", "from fresh to dry")

#: fields that are put in place of the good ones, and the beginning of the fault
FIELDS: list[tuple[dict[str, Any], str]] = [
    ({"extra": 1}, "unexpected field 'extra'"),
    ({"schema": 1}, "schema is 1; expected 2 or 3"),
    ({"kind": "hair"}, "kind is 'hair'; expected 'shell'"),
    ({"texel_density": 0}, "texel_density is 0; expected a number above 0"),
    ({"texel_density": float("nan")}, "texel_density is nan; expected a number above 0"),
    ({"texel_density": 10**400}, "texel_density is 1000"),
    ({"thickness": "1"}, "thickness is '1'; expected a number above 0"),
    ({"channels": 3.0}, "channels is 3.0; expected an integer, 1 or more"),
    ({"channels": True}, "channels is True; expected an integer, 1 or more"),
    ({"height_octaves": -1}, "height_octaves is -1; expected an integer, 0 or more"),
    ({"parameters": {}}, "parameters is {}; expected a list"),
    ({"parameters": [1]}, "parameter 0 is not a JSON object"),
    ({"colour_space": "sRGB"}, "colour_space is 'sRGB'; expected 'linear Rec. 709'"),
    ({"provenance": []}, "provenance is []; expected an object"),
]
PARAMETER: list[tuple[dict[str, Any], str]] = [
    ({"name": 1}, "parameter 0: name is 1; expected text"),
    ({"name": "length"}, "two parameters of one name in ['length', 'length']"),
    ({"role": "gamma"}, "parameter 0: role is 'gamma'; expected 'alpha' or 'beta'"),
    ({"role": []}, "parameter 0: role is []; expected 'alpha' or 'beta'"),
    ({"range": [1, 1]}, "parameter 0: range is [1, 1]; expected [lo, hi] with lo < hi"),
    ({"range": [0]}, "parameter 0: range is [0]; expected [lo, hi] with lo < hi"),
    ({"range": ["0", 1]}, "parameter 0: range is ['0', 1]; expected [lo, hi] with lo < hi"),
    ({"default": 1.5}, "parameter 0: default 1.5 is outside its range 0.0 to 1.0"),
    ({"default": -0.5}, "parameter 0: default -0.5 is outside its range 0.0 to 1.0"),
    ({"default": None}, "parameter 0: default is None; expected a number"),
    ({"unit": None}, "parameter 0: unit is None; expected text"),
    ({"meaning": 0}, "parameter 0: meaning is 0; expected text"),
    ({"extra": 0}, "parameter 0: unexpected field 'extra'"),
]
WRITTEN: list[tuple[dict[str, Any], str]] = [
    ({"thickness": float("nan")}, "cannot be written: manifest.json is not JSON: Out of range float values"),
    ({"provenance": {"path": Path("a")}}, "cannot be written: manifest.json is not JSON: Object of type"),
    ({"kind": "hair"}, "manifest.json: kind is 'hair'; expected 'shell'"),
    ({"channels": 2}, "array features/0 has shape (4, 8, 3); expected (H0, W0, C) = (4, 8, 2)"),
    ({"height_octaves": 3}, "array decoder/trunk/0/kernel has shape (9, 6); expected (T0, T1) = (11, 6)"),
    ({"parameters": ()}, "array decoder/trunk/0/kernel has shape (9, 6); expected (T0, T1) = (8, 6)"),
    ({"parameters": (AGE, AGE)}, "manifest.json: two parameters of one name in ['age', 'age']"),
    ({"parameters": (dataclasses.replace(AGE, default=2.0),)}, "manifest.json: parameter 0: default 2.0 is outside"),
]


class Edited:
    """A bundle's file whose manifest can be replaced, unchecked."""

    def __init__(self, path: Path, bundle: Bundle):
        self.path = path
        write_bundle(path, bundle)
        with np.load(path) as file:
            self.arrays: dict[str, Any] = {key: file[key] for key in file.files}
        self.manifest = json.loads(self.arrays.pop("manifest.json").tobytes())

    def save(self, text: bytes) -> Path:
        members: dict[str, Any] = {"manifest.json": np.frombuffer(text, np.uint8)} | self.arrays
        np.savez_compressed(self.path, **members)
        return self.path

    def save_with(self, fields: dict[str, Any]) -> Path:
        return self.save(json.dumps(self.manifest | fields).encode())


@pytest.fixture
def edited(tmp_path: Path, bundle: Bundle) -> Edited:
    return Edited(tmp_path / "a.npz", bundle)


def test_unknown_text_is_refused(edited: Edited, fault_of: Callable):
    start = "manifest.json is not JSON: "
    assert fault_of(read_bundle, edited.save(b'{"schema": }')) == start + "Expecting value: line 1 column 12 (char 11)"
    assert fault_of(read_bundle, edited.save(b"\xff")).startswith(start + "'utf-8' codec can't decode byte 0xff")
    assert (
        fault_of(read_bundle, edited.save(b"[" * 100_000))
        == "manifest.json is not JSON that can be read: nested too deep"
    )
    assert fault_of(read_bundle, edited.save(b"[1]")) == "manifest.json is not a JSON object"


def test_the_manifest_is_required(edited: Edited, fault_of: Callable):
    of_another_type: dict[str, Any] = {"manifest.json": np.zeros(2, np.int8)}
    for members in (edited.arrays, edited.arrays | of_another_type):
        np.savez_compressed(edited.path, **members)
        assert fault_of(read_bundle, edited.path) == "has no manifest.json of type uint8: not a bundle"


def test_each_field_but_twin_is_required(edited: Edited, fault_of: Callable):
    names = [*edited.manifest]
    assert names == sorted(
        ["schema", *(f.name for f in dataclasses.fields(Bundle) if f.name not in ("arrays", "tiles"))]
    )
    for name in names:
        rest = {key: value for key, value in edited.manifest.items() if key != name}
        path = edited.save(json.dumps(rest).encode())
        if name == "twin":
            assert read_bundle(path).twin is None
            continue
        assert fault_of(read_bundle, path) == f"manifest.json: field {name!r} is missing"


def test_each_field_of_a_parameter_is_required(edited: Edited, fault_of: Callable):
    for name in ("name", "role", "range", "default", "unit", "meaning"):
        rest = {key: value for key, value in edited.manifest["parameters"][0].items() if key != name}
        path = edited.save_with({"parameters": [rest]})
        assert fault_of(read_bundle, path) == f"manifest.json: parameter 0: field {name!r} is missing"


@pytest.mark.parametrize(("fields", "fault"), FIELDS)
def test_fields(edited: Edited, fault_of: Callable, fields: dict[str, Any], fault: str):
    assert fault_of(read_bundle, edited.save_with(fields)).startswith(f"manifest.json: {fault}")


@pytest.mark.parametrize(("fields", "fault"), PARAMETER)
def test_fields_of_a_parameter(edited: Edited, fault_of: Callable, fields: dict[str, Any], fault: str):
    first, second = edited.manifest["parameters"]
    path = edited.save_with({"parameters": [first | fields, second]})
    assert fault_of(read_bundle, path) == f"manifest.json: {fault}"


def test_roles_count_inputs(edited: Edited, fault_of: Callable):
    first, second = edited.manifest["parameters"]
    path = edited.save_with({"parameters": [first | {"role": "beta"}, second]})
    expected = "array decoder/trunk/0/kernel has shape (9, 6); expected (T0, T1) = (8, 6)"
    assert fault_of(read_bundle, path) == expected


@pytest.mark.parametrize(("fields", "fault"), WRITTEN)
def test_writing_checks_the_same(tmp_path: Path, bundle: Bundle, fault_of: Callable, fields: dict, fault: str):
    path = tmp_path / "a.npz"
    path.write_bytes(b"old")
    assert fault_of(write_bundle, path, dataclasses.replace(bundle, **fields)).startswith(fault)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.npz", b"old")]
