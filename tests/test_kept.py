"""What is kept of constants, and for how long."""

import gc
import weakref
from dataclasses import dataclass, replace

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.geometry.mesh import Mesh, load_mesh
from mesoshell.kept import MOST, constant, is_constant, kept


@dataclass(frozen=True)
class Thing:
    numbers: np.ndarray
    parts: dict


class Made:
    """What a function makes."""


def thing(n: int = 3) -> Thing:
    return constant(Thing(np.arange(n), {"a": np.zeros(n), "b": [np.ones(n)]}))


@pytest.fixture
def counted():
    calls = []

    @kept
    def make(x: object, n: object = 0) -> Made:
        calls.append(n)
        return Made()

    return make, calls


def test_constants_are_made_of_once(counted):
    make, calls = counted
    x = thing()
    first = make(x, 1)
    assert make(x, 1) is first
    assert make(x, 2) is not first
    assert calls == [1, 2]


def test_things_that_are_equal_but_not_the_same_are_made_of_anew(counted):
    make, _ = counted
    x, y = thing(), thing()
    assert make(x) is not make(y)
    assert make((x, x)) is not make((x, y))


def test_words_and_numbers_of_other_types_are_others(counted):
    make, calls = counted
    x = thing()
    for n in (1, 1.0, True, "1", None):
        make(x, n)
    assert len(calls) == 5


@pytest.mark.parametrize("which", ["numbers", "in a mapping", "in a list", "alone"])
def test_what_can_be_written_to_is_made_of_anew(counted, which):
    make, calls = counted
    x = thing()
    array = {"numbers": x.numbers, "in a mapping": x.parts["a"], "in a list": x.parts["b"][0], "alone": np.zeros(2)}[
        which
    ]
    array.setflags(write=True)
    given = array if which == "alone" else x
    assert not is_constant(given)
    make(given)
    make(given)
    assert len(calls) == 2


def test_no_more_is_kept_than_most(counted):
    make, calls = counted
    x = thing()
    for n in (*range(MOST + 1), MOST, 0):
        make(x, n)
    assert calls == [*range(MOST + 1), 0]


def test_what_was_made_is_freed_with_what_it_was_made_of(counted):
    make, _ = counted
    x = thing()
    made = weakref.ref(make(x))
    gc.collect()
    assert made() is not None
    del x
    gc.collect()
    assert made() is None


def test_meshes_and_materials_of_files_are_constants():
    assert is_constant(load_mesh("tests/data/spot.obj"))
    assert is_constant(ms.load_material("grass").bundle)


def test_a_picture_after_others_is_the_first_one_again(tiny_bundle):
    """Nothing that is kept of one scene shows in another: neither of a thicker shell, nor of objects beside it."""
    cube = load_mesh("tests/data/cross.obj")
    own = constant(replace(tiny_bundle, arrays={name: x.copy() for name, x in tiny_bundle.arrays.items()}))
    scene = ms.Scene(cube, ms.Material("tiny", own), size=(24, 24), thickness=0.2, scale=1.0)
    beside = replace(cube, vertices=cube.vertices + np.float32(0.4))
    others = (replace(scene, thickness=0.4), replace(scene, objects=(beside,)))
    quality = ms.Quality(pixel_samples=1, samples=8, density="network")
    first = ms.render(scene, quality=quality).rgba
    for other in others:
        assert np.abs(ms.render(other, quality=quality).rgba - first).max() > 0.01
        np.testing.assert_array_equal(ms.render(scene, quality=quality).rgba, first)


def test_a_mesh_that_is_written_to_is_seen(tiny_bundle):
    own = {
        name: getattr(load_mesh("tests/data/cross.obj"), name).copy() for name in ("vertices", "faces", "uv", "normals")
    }
    mesh = Mesh(**own, notes=())
    scene = ms.Scene(
        mesh,
        ms.Material("tiny", tiny_bundle),
        size=(24, 24),
        thickness=0.2,
        scale=1.0,
        camera=(3.0, 4.0, 5.0, 0.0, 0.0, 0.0, 40.0),
    )
    quality = ms.Quality(pixel_samples=1, samples=8, density="network")
    first = ms.render(scene, quality=quality).rgba
    mesh.vertices[:, 1] *= 0.5
    assert np.abs(ms.render(scene, quality=quality).rgba - first).max() > 0.01


def test_another_array_in_the_same_bundle_is_seen(counted):
    make, calls = counted
    x = thing()
    make(x)
    other = np.zeros(3)
    other.setflags(write=False)
    x.parts["a"] = other
    make(x)
    make(x)
    assert len(calls) == 2


def test_what_shows_memory_that_can_be_written_to_is_no_constant():
    base = np.zeros(4)
    view = base[1:]
    view.setflags(write=False)
    assert not is_constant(view) and not is_constant((1, view)) and not is_constant([1])
    base.setflags(write=False)
    assert is_constant(view)
