"""Geometry that varies over a texture is read by the path tracer as by the JAX engine; without it nothing of it is compiled."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import jax
import jax.numpy as jnp
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io import cache
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.cache import cache_folder
from mesoshell.io.image import read_png, write_png
from mesoshell.pathtracer import load_file, maps, texture_cache
from mesoshell.pathtracer.heights import Heights
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.samples import Sample
from mesoshell.pathtracer.texture_cache import TextureKey, with_texture
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle, field_of, grow
from mesoshell.shell.geometry.extrude import extrude, patches_per_uv
from mesoshell.shell.material.field import Point, neural_field
from mesoshell.shell.material.loader import load_device_material
from tests.helpers import caches, growing
from tests.helpers.path_traced import rough

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("nodes")

ORIGIN, COUNT = (-2, 3), 600


@pytest.fixture(scope="module")
def varying() -> Bundle:
    """A texture of 4½ × 3 patches, its geometry a ramp along u with a step along v."""

    def ramp(at: np.ndarray) -> np.ndarray:
        return np.clip(at[..., 0] / 5 + (at[..., 1] > 1.5) * 0.3, 0, 1)

    return rough(bake_bundle(growing.bundle(), "it", (48, 72), TextureRequest(7, {}, {"length": ramp}))[0])


@pytest.fixture(scope="module")
def points() -> dict[str, np.ndarray]:
    """All over the texture, on nodes and far beyond its edges; filters from nothing to more than the height."""
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(2, 3, COUNT))
    xi = rng.uniform([[-3], [-2], [0]], [[7], [6], [1]], (3, COUNT))
    xi[:2, ::7] = np.round(xi[:2, ::7])
    xi[:2] += np.array(ORIGIN)[:, None]
    radius = np.exp(rng.uniform(-9, 1, COUNT)) * (rng.random(COUNT) > 0.1)
    toward = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    found = {"xi": xi, "radius": radius, "deviation": radius[::-1], "alpha": rng.random((1, COUNT))}
    return {k: v.astype(np.float32) for k, v in (found | {"w": toward[0], "light": toward[1]}).items()}


def asked(material: Material, points: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """σ and ρ by the path tracer."""
    xi, w, light = (mi.Vector3f(points[k]) for k in ("xi", "w", "light"))
    radius, deviation, alpha = (mi.Float(points[k].ravel()) for k in ("radius", "deviation", "alpha"))
    sigma, features = material.density_of(
        material.inputs(Sample(mi.UInt32(0), mi.Float(0), xi, radius, deviation, mi.Float(0), mi.Vector2f(0)), [alpha])
    )
    return np.array(sigma), np.array(material.transport(list(features), w, light)).T


def expected(bundle: Bundle, points: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """σ and ρ by the JAX engine."""
    made = load_device_material(bundle, ORIGIN)
    field = neural_field(made.material, made.layout)

    def one(xi, radius, deviation, alpha, w, light):
        sigma, features = field.density(Point(xi, radius, deviation, alpha))
        return sigma, field.transport(features, w, light)

    rows = [jnp.asarray(points[k].T) for k in ("xi", "radius", "deviation", "alpha", "w", "light")]
    sigma, rho = jax.jit(jax.vmap(one))(*rows)
    return np.asarray(sigma), np.asarray(rho)


def test_extinction_and_transport_are_those_of_the_jax_engine(varying, points) -> None:
    """To 1e-5 of the largest value; the mean height feature is off by more than a hundred times that."""
    sigma, rho = expected(varying, points)
    ours, our_rho = asked(Material(varying, ORIGIN), points)
    np.testing.assert_allclose(ours, sigma, rtol=0, atol=1e-5 * sigma.max())
    np.testing.assert_allclose(our_rho, rho, rtol=0, atol=1e-5 * rho.max())
    of_mean, _ = asked(Material(of_means(varying), ORIGIN), points)
    assert np.abs(of_mean - sigma).max() > 1e-3 * sigma.max()


def of_means(bundle: Bundle) -> Bundle:
    """The same texture with one height feature, the mean."""
    return replace(bundle, arrays={k: v for k, v in bundle.arrays.items() if not k.startswith("heights/")})


def operations(heights: Heights) -> int:
    """Of the program that looks F(h) up."""
    xi, deviation = dr.zeros(mi.Vector3f, 64), dr.full(mi.Float, 0.1, 64)
    dr.make_opaque(xi, deviation)
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.eval(heights.at(xi, deviation))
        return sum(k["operation_count"] for k in dr.kernel_history())


def test_where_geometry_does_not_vary_nothing_of_it_is_compiled(varying) -> None:
    """Of four lookups there is one, and no weights between them."""
    at_nodes, of_mean = (Heights(x.arrays, ORIGIN) for x in (varying, of_means(varying)))
    assert of_mean.nodes is None and at_nodes.nodes == (4, 6)
    assert operations(of_mean) < 0.5 * operations(
        at_nodes
    )  # what Dr.Jit counts varies a little from machine to machine
    assert len(of_mean.levels.rows) * 24 == len(at_nodes.levels.rows)


SCENE = """<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="perspective"><float name="fov" value="30"/>
        <transform name="to_world"><lookat origin="0.5,-1.6,2.4" target="0.5,0.5,0.4" up="0,0,1"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
    <emitter type="directional"><vector name="direction" value="-0.3,0.2,-1"/></emitter>
    <shape type="obj"><string name="filename" value="square.obj"/>
        <bsdf type="mesoshell"><string name="material" value="it.npz"/>
            <float name="thickness" value="0.4"/><float name="scale" value="0.4"/><integer name="seed" value="3"/>
            LENGTH
        </bsdf></shape>
</scene>
"""
BITMAP = '<texture type="bitmap" name="length"><string name="filename" value="comb.png"/>MORE</texture>'
NEAREST = '<string name="filter_type" value="nearest"/>'
#: Dark on one side, bright on the other, and another way up than in Mitsuba; nodes, at halves, lie within pixels.
COMB = np.array([[0.05, 0.5, 0.9], [0.1, 0.4, 0.7], [0.3, 0.2, 0.6]], np.float32)


@pytest.fixture
def folder(tmp_path, tmp_path_factory, monkeypatch) -> Path:
    """A square, a material with a generator, and an image."""
    monkeypatch.setenv("XDG_CACHE_HOME", caches.own(tmp_path / "cache", tmp_path_factory))
    write_bundle(tmp_path / "it.npz", growing.bundle())
    write_png(tmp_path / "comb.png", np.repeat(COMB[..., None], 3, axis=-1))
    (tmp_path / "square.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n"
    )
    return tmp_path


def scene(folder: Path, length: str) -> Any:
    (folder / "scene.xml").write_text(SCENE.replace("LENGTH", length))
    return load_file(folder / "scene.xml")


def test_a_texture_of_a_scene_varies_geometry_as_an_image_of_the_command_line_does(folder, monkeypatch) -> None:
    """The same pixels, which are the nearest ones there: the same texture, grown for the same surface. (By the command in this
    process; tests of paths have one of its own.)"""
    monkeypatch.setattr("mesoshell.pathtracer.load.texels_needed", lambda *_: growing.TEXELS)
    monkeypatch.setattr(texture_cache, "_run", lambda path, options: main(["texture", str(path), *options]))
    made = scene(folder, BITMAP.replace("MORE", NEAREST))
    (material,) = made.integrator().context.media.materials
    mesh = load_mesh(folder / "square.obj")
    shell = extrude(mesh, 0.4, 0.4)
    patches = patches_per_uv(mesh, shell)
    image = read_png(folder / "comb.png").mean(axis=-1)
    wanted = TextureRequest(3, {}, {"length": field_of(image, (patches, patches), False)})
    bundle, origin = grow(growing.bundle(), "it", shell.uv, wanted)
    assert material.origin == origin
    expected = Material(bundle, origin)
    assert material.heights.nodes == expected.heights.nodes
    at_nodes = bundle.arrays["heights/0"].astype(np.float32)
    assert np.ptp(at_nodes, axis=(0, 1)).max() > 0.1
    for ours, theirs in ((material.heights.levels, expected.heights.levels), (material.plane, expected.plane)):
        np.testing.assert_allclose(np.array(ours.rows), np.array(theirs.rows), rtol=2e-3, atol=2e-3)
    assert np.isfinite(np.array(mi.render(made, spp=4))).all()


def test_a_texture_that_the_caches_disk_cannot_hold_is_made_elsewhere(folder, monkeypatch) -> None:
    class Full:
        free = 1000

    def run(path: Path, options: list[str]) -> None:
        written.append(Path(options[-1]))
        shutil.copy(path, written[-1])

    written: list[Path] = []
    room, uv, wanted = cache_folder("textures"), np.zeros((1, 3, 2)), TextureKey(0, {}, growing.TEXELS)
    monkeypatch.setattr(texture_cache, "_run", run)
    monkeypatch.setattr(cache.shutil, "disk_usage", lambda path: Full)
    made, _, _ = with_texture(folder / "it.npz", growing.bundle(), uv, wanted)
    assert made.arrays.keys() == growing.bundle().arrays.keys()
    assert room not in written[0].parents and not written[0].exists()


SQUARE, BEYOND = np.array([[0.0, 0], [1, 0], [1, 1]]), np.array([[0.0, 0], [2, 0], [1, 1]])


@pytest.mark.parametrize("flipped", [False, True])
def test_between_pixels_and_beyond_the_edge(flipped) -> None:
    """Of a mesh within the unit square what lies beyond it is the edge, and it is not blended with the other side; else the
    image repeats."""
    image = COMB[:, :, None] if flipped else COMB[::-1, :, None].copy()  # Mitsuba's first row has v = 0
    texture = mi.load_dict({"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True})
    inside, repeated = (maps.field_of("length", texture, 2.0, flipped, uv, "it") for uv in (SQUARE, BEYOND))
    at = 2 * np.array([[[0.5, 0.5], [1 / 3, 0.5]], [[1.0, 0.0], [1.7, -3.0]]])
    expected = [[0.4, 0.25], [0.6, 0.6]]
    np.testing.assert_allclose(inside(at), expected, atol=1e-6)
    np.testing.assert_allclose(repeated(at + 4.0)[0], expected[0], atol=1e-5)
    np.testing.assert_allclose(repeated(np.array([[2.0, 1.0]])), [(0.7 + 0.1) / 2], atol=1e-5)


@pytest.mark.parametrize(
    ("length", "said"),
    [
        (
            '<texture type="mesh_attribute" name="length"><string name="name" value="vertex_c"/></texture>',
            "mesh_attribute",
        ),
        (
            '<texture type="mesh_attribute" name="age"><string name="name" value="vertex_c"/></texture>',
            "mesh_attribute",
        ),
        ('<texture type="checkerboard" name="leng"/>', "no parameter 'leng'; did you mean length?"),
    ],
)
def test_textures_that_cannot_be_read_are_refused(folder, length, said) -> None:
    with pytest.raises(InputError, match=said) as fault:
        scene(folder, length)
    assert "\n" not in str(fault.value)


def test_a_material_without_a_generator_refuses(folder, varying) -> None:
    write_bundle(folder / "it.npz", varying)
    with pytest.raises(InputError, match="has no generator: it is one texture, of one seed and one"):
        scene(folder, BITMAP.replace("MORE", ""))
