"""A small random object: its pictures against rays marched one by one, its texture and edits of it, its mesh, and its file."""

import json
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.archive import read_arrays, write_arrays
from mesoshell.io.image import srgb_to_linear, write_png
from mesoshell.io.mesh_export import write_textured_mesh
from mesoshell.nets.mlp import Dense
from mesoshell.neutex import render as rendering
from mesoshell.neutex.cameras import photo_rays, pixels
from mesoshell.neutex.edit import paint_of, read_edit, texture_image
from mesoshell.neutex.field import (
    density,
    init_field,
    lobes,
    texture,
    to_surface,
    to_texture,
    view_reflectance,
)
from mesoshell.neutex.layout import LAYOUTS, checkerboard, directions, shape
from mesoshell.neutex.march import CELLS, march
from mesoshell.neutex.mesh import REACH, extract_mesh
from mesoshell.neutex.render import Lighting, Paint, View, occupancy, picture
from mesoshell.neutex.store import read_neutex, write_neutex
from mesoshell.render.camera import look_at
from mesoshell.render.light import Distant, environment
from mesoshell.render.quality import Quality
from tests.helpers.octahedron import CONFIG, PHOTO, octahedron
from tests.helpers.octahedron import model as captured

EXACT = Quality(pixel_samples=1, samples=64, early_stop=0.0, skip=0.0)
FULL = jnp.ones((CELLS,) * 3, bool)
surfaces = jax.jit(jax.vmap(to_surface, in_axes=(None, 0)))


@pytest.fixture(scope="module", autouse=True)
def _small_tiles():
    """Pictures here have 320 rays: two tiles, the second padded, and not one of 1024 that is mostly nothing."""
    with pytest.MonkeyPatch.context() as change:
        change.setattr("mesoshell.neutex.render.TILE", 192)
        yield


@pytest.fixture(scope="module")
def field():
    return octahedron()


def test_a_picture_is_its_rays(field) -> None:
    found = picture(CONFIG, field, PHOTO, View(EXACT, FULL))
    o, d = (jnp.asarray(x, jnp.float32) for x in photo_rays(PHOTO, pixels(PHOTO)))
    each = jax.jit(jax.vmap(lambda o, d: march(CONFIG, field, o, d, FULL, jnp.full(64, 0.5))))(o, d)
    alpha = 1 - np.asarray(each.passed).reshape(16, 20)
    assert 0.05 < alpha.mean() < 0.95
    np.testing.assert_allclose(found.rgba[..., 3], alpha, atol=2e-5)
    np.testing.assert_allclose(
        found.rgba[..., :3], np.maximum(np.asarray(each.colour), 0).reshape(16, 20, 3), atol=2e-5
    )
    far = jnp.sum(each.w * jnp.linalg.norm(each.y - o[:, None], axis=-1), axis=1)
    np.testing.assert_allclose(found.depth, np.asarray(far).reshape(16, 20), atol=1e-4)


@pytest.mark.parametrize("stop", [pytest.param(0.01, marks=pytest.mark.slow), 0.3])
def test_stopping_early_misses_no_more_than_it_says(field, stop) -> None:
    exact = picture(CONFIG, field, PHOTO, View(EXACT, FULL)).rgba
    found = picture(CONFIG, field, PHOTO, View(EXACT.with_changes(early_stop=stop), FULL)).rgba
    assert np.abs(found[..., 3] - exact[..., 3]).max() <= stop + 1e-5


def test_skipping_misses_no_more_than_it_says(field) -> None:
    """With many samples, so that what is left is what was skipped and not where samples lie."""
    fine = EXACT.with_changes(samples=256)
    exact = picture(CONFIG, field, PHOTO, View(fine, FULL)).rgba[..., 3]
    skip = 0.3
    occupied = occupancy(CONFIG, field, skip)
    assert not bool(occupied.all())
    found = picture(CONFIG, field, PHOTO, View(fine, occupied)).rgba[..., 3]
    assert (exact - found).max() <= 1 - np.exp(-skip) + 0.01


@pytest.mark.parametrize("lit", [False, True])
def test_rays_that_meet_nothing_are_not_marched(lit: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of a picture that shows nothing; half of one whose other half is not occupied."""
    config = replace(CONFIG, colour="reflectance", flash=1.0) if lit else CONFIG
    made, counted = octahedron(config), []
    tiles = rendering._tiles
    monkeypatch.setattr(rendering, "_tiles", lambda *given: counted.append(int(given[-1])) or tiles(*given))
    light = Lighting((Distant(np.array([0.0, 0, 1]), np.ones(3)),), None) if lit else None
    empty = jnp.zeros((CELLS,) * 3, bool)
    found = picture(config, made, PHOTO, View(EXACT, empty, None, light))
    assert not found.rgba.any() and not found.depth.any() and sum(counted) == 0
    counted.clear()
    half = FULL.at[:, : CELLS // 2].set(False)
    found = picture(config, made, PHOTO, View(EXACT, half, None, light))
    assert found.rgba[..., 3].max() > 0.5 and 0 < counted[0] < 0.9 * PHOTO.width * PHOTO.height


def test_nothing_is_skipped_unless_it_may_be(field) -> None:
    assert bool(occupancy(CONFIG, field, 0.0).all())


#: What a layout's pixels are, tests of layouts say.
@pytest.mark.parametrize("layout", [pytest.param(x, marks=() if x == "latlong" else pytest.mark.slow) for x in LAYOUTS])
def test_the_texture_put_back_changes_nothing(field, layout) -> None:
    image = texture_image(captured(field), layout, 32)
    assert image.shape == (*shape(layout, 32), 3) and (image >= 0).all() and image.std() > 0.01
    plain = picture(CONFIG, field, PHOTO, View(EXACT, FULL)).rgba
    again = picture(CONFIG, field, PHOTO, View(EXACT, FULL, paint_of(captured(field), layout, image, "replace"))).rgba
    np.testing.assert_allclose(again, plain, atol=1e-4)


@pytest.mark.parametrize("edit", [pytest.param("replace", marks=pytest.mark.slow), "multiply"])
def test_what_is_transparent_changes_nothing(field, edit) -> None:
    nothing = np.zeros((32, 64, 4), np.float32)
    plain = picture(CONFIG, field, PHOTO, View(EXACT, FULL)).rgba
    again = picture(CONFIG, field, PHOTO, View(EXACT, FULL, paint_of(captured(field), "latlong", nothing, edit))).rgba
    np.testing.assert_allclose(again, plain, atol=1e-6)


def test_the_texture_is_as_cameras_before_it_see_it(field) -> None:
    """What views add is taken from places where photographs were, not from behind the surface: by each texel's own sum. Where
    no camera was, straight on."""
    eyes = [(2.5, 1.0, 1.5), (-1.0, 2.5, 1.5)]
    photos = tuple(PHOTO._replace(to_world=look_at(eye, (0, 0, 0), (0, 0, 1))) for eye in eyes)
    all_u = directions("latlong", 8).reshape(-1, 3)
    found = texture_image(replace(captured(field), photos=photos), "latlong", 8).reshape(-1, 3)
    alone = 0
    for u, wanted in zip(all_u, found, strict=True):
        base, features = texture(CONFIG, field, jnp.asarray(u))
        y = np.asarray(to_surface(field, jnp.asarray(u)))  # all but a sphere yet
        ways = [w for w in (normalised(np.array(eye) - y) for eye in eyes) if w @ u > 0.1]
        if any(abs(normalised(np.array(eye) - y) @ u - 0.1) < 0.02 for eye in eyes):
            continue
        alone += not ways
        views = [view_reflectance(CONFIG, field, features, jnp.asarray(-w, jnp.float32)) for w in ways or [u]]
        np.testing.assert_allclose(wanted, np.maximum(base + np.max(views, axis=0), 0), rtol=2e-2, atol=1e-3)
    assert 0 < alone < len(found) / 2


def test_more_rays_a_pixel_are_the_mean_of_theirs(field) -> None:
    """Of pictures by cameras whose images are shifted within a pixel, evenly."""
    places = [pixels(PHOTO, 4, k)[0] for k in range(4)]
    assert np.ptp(places, axis=0).min() > 0.4
    each = []
    for x, y in places:
        fx, fy, cx, cy = PHOTO.lens
        moved = PHOTO._replace(lens=(fx, fy, cx + 0.5 - x, cy + 0.5 - y))
        each.append(picture(CONFIG, field, moved, View(EXACT, FULL)).rgba)
    found = picture(CONFIG, field, PHOTO, View(EXACT.with_changes(pixel_samples=4), FULL)).rgba
    np.testing.assert_allclose(found, np.mean(each, axis=0), atol=1e-4)


def test_multiplying_by_a_colour_multiplies_every_view(field) -> None:
    tint = np.array([0.5, 1.0, 0.25], np.float32)
    image = np.broadcast_to(tint, (16, 16, 3))
    quiet = field._replace(view=jax.tree.map(jnp.zeros_like, field.view))
    plain = picture(CONFIG, quiet, PHOTO, View(EXACT, FULL)).rgba
    found = picture(
        CONFIG, quiet, PHOTO, View(EXACT, FULL, paint_of(captured(quiet), "square", image, "multiply"))
    ).rgba
    np.testing.assert_allclose(found[..., :3], plain[..., :3] * tint, atol=1e-5)
    np.testing.assert_array_equal(found[..., 3], plain[..., 3])


def test_replacing_by_a_colour_leaves_what_views_add(field) -> None:
    """Without it the object is the colour; with it, no brighter."""
    image = np.full((16, 16, 3), 0.2, np.float32)
    quiet = field._replace(view=jax.tree.map(jnp.zeros_like, field.view))
    for made, slack in ((quiet, 0.02), (field, 0.05)):
        edit = paint_of(captured(made), "square", image, "replace")
        found = picture(CONFIG, made, PHOTO, View(EXACT, FULL, edit)).rgba
        assert (found[..., :3] <= 0.2 * found[..., 3:] + slack).all()
        if made is quiet:
            np.testing.assert_allclose(found[..., :3], 0.2 * np.repeat(found[..., 3:], 3, axis=-1), atol=0.02)


def test_an_edit_stays_where_it_is_in_every_view(field) -> None:
    """Half of the sphere painted red: in two views, what is red is what F_uv says lies in that half."""
    image = np.zeros((64, 128, 4), np.float32)
    image[:, 64:] = [1, 0, 0, 1]
    dense = field._replace(
        sigma=field.sigma._replace(last=field.sigma.last._replace(bias=jnp.full(1, 60.0))),
        view=jax.tree.map(jnp.zeros_like, field.view),
    )
    paint = paint_of(captured(dense), "latlong", image, "replace")
    for eye in ((2.5, 0.8, 0.6), (-0.7, 2.4, -0.9)):
        photo = PHOTO._replace(to_world=look_at(eye, (0, 0, 0), (0, 0, 1)))
        seen = picture(CONFIG, dense, photo, View(EXACT, FULL))
        red = picture(CONFIG, dense, photo, View(EXACT, FULL, paint))
        o, d = photo_rays(photo, pixels(photo))
        y = jnp.asarray(o + seen.depth.reshape(-1, 1) * d, jnp.float32)
        u = np.asarray(jax.jit(jax.vmap(lambda y: to_texture(dense, y)))(y)).reshape(16, 20, 3)
        hit = seen.rgba[..., 3] > 0.99
        sure = hit & (np.abs(np.arctan2(u[..., 1], u[..., 0])) > 0.1) & (np.abs(np.arctan2(u[..., 1], u[..., 0])) < 3.0)
        assert sure.sum() > 30
        wanted = np.arctan2(u[..., 1], u[..., 0]) > 0
        np.testing.assert_array_equal((red.rgba[..., 0] > 0.95)[sure], wanted[sure])


def test_edits_are_read_by_their_proportions(tmp_path) -> None:
    write_png(tmp_path / "a.png", np.zeros((32, 48, 3), np.float32))
    assert read_edit(tmp_path / "a.png", None)[0] == "cubemap"
    with pytest.raises(InputError, match=r"a.png: is 48 x 32 pixels, the proportions of no latlong \(2:1\)"):
        read_edit(tmp_path / "a.png", "latlong")
    write_png(tmp_path / "a.png", np.zeros((32, 47, 3), np.float32))
    with pytest.raises(InputError, match=r"of no cubemap .* or latlong .* or square"):
        read_edit(tmp_path / "a.png", None)


def test_the_mesh_is_closed_outside_out_and_where_the_map_says(field) -> None:
    found = extract_mesh(CONFIG, field, 12, 64)
    one, of = np.unique(found.vertices, axis=0, return_inverse=True)  # the same bits, as meshes are welded
    mesh = trimesh.Trimesh(one, of.ravel()[found.faces], process=False)
    assert len(one) == 6 * 12**2 + 2 and mesh.is_watertight and mesh.euler_number == 2
    middle = found.vertices[found.faces].mean(axis=1)
    corners = found.vertices[found.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normals, middle) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1, atol=1e-9)
    of_corners = np.einsum("tki,ti->tk", found.normals[found.faces], normals)
    assert (of_corners > 0).all()


def test_the_mesh_lies_where_half_of_the_light_is_through(field) -> None:
    """Along the way that a vertex moved from F_uv⁻¹'s surface, by fine steps."""
    found = extract_mesh(CONFIG, field, 6, 64)
    wrap = np.asarray(surfaces(field, jnp.asarray(found.u, jnp.float32)), np.float64)
    moved = found.vertices - wrap
    moved, wrap, u = (x[np.linalg.norm(moved, axis=1) > 1e-3] for x in (moved, wrap, found.u))
    out = moved / np.linalg.norm(moved, axis=1, keepdims=True)
    out *= np.sign(np.einsum("ij,ij->i", out, u))[:, None]
    s = (np.arange(2000) + 0.5) / 2000 * 2 * REACH
    y = wrap[:, None] + (REACH - s)[:, None] * out[:, None]
    sigma = jax.jit(jax.vmap(jax.vmap(lambda y: density(CONFIG, field, y)[0])))(jnp.asarray(y, jnp.float32))
    sigma = np.asarray(sigma, np.float64)
    deep = np.cumsum(sigma, axis=1) * (2 * REACH / 2000)
    half = (deep < np.log(2)).sum(axis=1)
    there = (half < 2000) & (sigma[:, 0] < 0.4 * sigma[np.arange(len(half)), half % 2000])
    assert there.sum() > 20
    np.testing.assert_allclose(np.einsum("ij,ij->i", moved, out)[there], (REACH - s[half % 2000])[there], atol=2e-3)


def test_a_mesh_of_nothing_is_the_inverse_maps(field) -> None:
    empty = field._replace(sigma=field.sigma._replace(last=field.sigma.last._replace(bias=jnp.full(1, -40.0))))
    found = extract_mesh(CONFIG, empty, 8, 64)
    wanted = surfaces(field, jnp.asarray(found.u, jnp.float32))
    np.testing.assert_allclose(found.vertices, wanted, atol=1e-6)


def test_a_vertex_that_begins_inside_knows_no_surface(field) -> None:
    """In the middle of fog without an end nothing moves, though half of the light is soon gone."""
    last = field.sigma.last
    even = last._replace(kernel=jnp.zeros_like(last.kernel), bias=jnp.full(1, 4.0))  # σ = 100
    found = extract_mesh(CONFIG, field._replace(sigma=field.sigma._replace(last=even)), 6, 64)
    wrap = surfaces(field, jnp.asarray(found.u, jnp.float32))
    np.testing.assert_allclose(found.vertices, wrap, atol=1e-6)


def test_what_knows_no_surface_follows_what_does(field) -> None:
    """The tips of a large octahedron lie farther from the wrap than a vertex looks; no step is left around them."""
    large = field._replace(sigma=field.sigma._replace(last=field.sigma.last._replace(bias=jnp.full(1, 11.0))))
    found = extract_mesh(CONFIG, large, 12, 64)
    wrap = np.asarray(surfaces(field, jnp.asarray(found.u, jnp.float32)))
    move = np.linalg.norm(found.vertices - wrap, axis=1)
    # the surface is |y|₁ = 1.1 or so: 0.64 from the middle in the midst of a face, and 1.1 at the tips; the wrap is at 0.6
    tip = np.abs(found.u).max(axis=1) > 0.97
    assert tip.any() and move[tip].min() > 0.03 and move.max() < REACH
    assert np.abs(move[found.faces[:, 0]] - move[found.faces[:, 1]]).max() < 0.05


def test_no_triangle_folds_however_rough_the_density(field, monkeypatch) -> None:
    """Each vertex wants to move on its own, by as much as it may."""
    random = np.random.default_rng(2)
    found = lambda kernel, y, n: (random.uniform(-REACH, REACH, len(y)), np.ones(len(y)))  # noqa: E731
    monkeypatch.setattr("mesoshell.neutex.mesh.run", found)
    mesh = extract_mesh(CONFIG, field, 24, 64)
    wrap = np.asarray(surfaces(field, jnp.asarray(mesh.u, jnp.float32)))
    before, after = (
        np.cross(x[mesh.faces[:, 1]] - x[mesh.faces[:, 0]], x[mesh.faces[:, 2]] - x[mesh.faces[:, 0]])
        for x in (wrap, mesh.vertices)
    )
    assert (np.einsum("ti,ti->t", before, after) > 0).all()
    assert np.linalg.norm(mesh.vertices - wrap, axis=1).mean() > 1e-3


def test_the_meshs_coordinates_are_the_cubemaps(field) -> None:
    """Each vertex finds its direction in an image of directions, and no triangle leaves its square."""
    found = extract_mesh(CONFIG, field, 8, 128)
    image = directions("cubemap", 128)
    h, w = image.shape[:2]
    inside = np.abs(found.uv * [3, 2] - np.round(found.uv * [3, 2])).min(axis=1) > 0.02
    x, y = np.floor(found.uv[:, 0] * w).astype(int), np.floor((1 - found.uv[:, 1]) * h).astype(int)
    np.testing.assert_allclose(image[y[inside], x[inside]], found.u[inside], atol=0.02)
    square = found.uv[found.faces] * [3, 2]
    assert (np.ptp(square, axis=1) <= 1 / 8 * 1.7).all()


def test_a_file_holds_all_of_it(field, tmp_path) -> None:
    write_neutex(tmp_path / "a.npz", captured(field, centre=(1.0, 2.0, 3.0), half=2.5))
    found = read_neutex(tmp_path / "a.npz")
    assert found.config == CONFIG and found.half == 2.5 and found.tested == (1,) and found.provenance == {"rays": 5}
    for a, b in zip(jax.tree.leaves(found.field), jax.tree.leaves(field), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(found.photos[0].to_world, PHOTO.to_world)
    assert found.photos[0][1:] == PHOTO[1:]


def test_a_point_keeps_its_place_between_world_and_box(field) -> None:
    """A camera moved to the box sees a point there where the world's sees it."""
    found = captured(field, centre=(1.0, 2.0, 3.0), half=2.5)
    o, d = photo_rays(found.to_box(PHOTO), pixels(PHOTO))
    far, towards = photo_rays(PHOTO, pixels(PHOTO))
    np.testing.assert_allclose(found.centre + found.half * (o + 0.7 * d), far + 0.7 * 2.5 * towards, atol=1e-12)


def said(arrays: dict[str, np.ndarray], **entries: Any) -> dict[str, np.ndarray]:
    """A file's arrays with other entries in its manifest."""
    about = json.loads(arrays["manifest.json"].tobytes()) | entries
    return {**arrays, "manifest.json": np.frombuffer(json.dumps(about).encode(), np.uint8)}


def told(**entries: Any) -> dict[str, Any]:
    return {**PHOTO._asdict(), "to_world": PHOTO.to_world.tolist()} | entries


@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (lambda a: {k: v for k, v in a.items() if k != "uv/last/kernel"}, "uv/last/kernel is missing"),
        (lambda a: {**a, "uv/last/kernel": np.zeros((2, 2), np.float32)}, r"uv/last/kernel is \(2, 2\)"),
        (lambda a: {**a, "uv/last/bias": np.zeros(3)}, r"uv/last/bias is \(3,\) of float64"),
        (lambda a: {**a, "uv/last/bias": np.full(3, np.nan, np.float32)}, "weights that are not finite"),
        (lambda a: {**a, "manifest.json": np.frombuffer(b"{}", np.uint8)}, "is not a captured object"),
        (lambda a: {k: v for k, v in a.items() if k != "manifest.json"}, "has no manifest.json"),
        (lambda a: said(a, photos=[], tested=[]), "it has no photograph"),
        (lambda a: said(a, photos=[told(lens=[0, 20, 10, 8])], tested=[]), "or one whose camera is none"),
        (
            lambda a: said(a, photos=[told(to_world=np.full((4, 4), np.inf).tolist())], tested=[]),
            "or one whose camera is none",
        ),
        (lambda a: said(a, provenance={"config": {"samples": "many"}}), "learned with 'many' samples a ray"),
        (lambda a: said(a, provenance={"config": {"samples": 10**9}}), "learned with 1000000000 samples a ray"),
    ],
)
def test_damaged_files_are_named(field, tmp_path, spoil, fault) -> None:
    path = tmp_path / "a.npz"
    write_neutex(path, captured(field))
    names = json.loads(read_arrays(path, ["manifest.json"])["manifest.json"].tobytes())
    assert names["kind"] == "captured object"
    with np.load(path) as file:
        arrays = {k: file[k] for k in file.files}
    write_arrays(path, spoil(arrays))
    with pytest.raises(InputError, match=rf"a.npz: .*{fault}"):
        read_neutex(path)


def test_a_volume_has_the_same_file(tmp_path) -> None:
    config = replace(CONFIG, colour="volume")
    made = init_field(config, jax.random.key(0))
    write_neutex(tmp_path / "a.npz", replace(captured(made), config=config))
    assert read_neutex(tmp_path / "a.npz").config == config


def test_the_checkerboard_shows_as_it_is(field) -> None:
    """All of the object's own colours are gone."""
    board = checkerboard("cubemap", 16, 4)
    paint = Paint("cubemap", np.concatenate([board, np.zeros_like(board)], axis=-1))
    a = picture(CONFIG, field, PHOTO, View(EXACT, FULL, paint)).rgba
    b = picture(
        CONFIG, field._replace(texture=jax.tree.map(jnp.zeros_like, field.texture)), PHOTO, View(EXACT, FULL, paint)
    ).rgba
    np.testing.assert_allclose(a, b, atol=1e-6)


LIT = replace(CONFIG, colour="reflectance", flash=4.0)


@pytest.fixture(scope="module")
def stone():
    """The same octahedron, dense, of a grey matt surface whose normals point out of the box's middle."""
    made: Any = init_field(LIT, jax.random.key(3))
    grey = jax.tree.map(jnp.zeros_like, made.texture)
    first, second = np.zeros((9, 16), np.float32), np.zeros((16, 16), np.float32)
    first[:3, :6], second[:6, :6] = np.concatenate([np.eye(3), -np.eye(3)], axis=1), np.eye(6)
    last = np.zeros((16, 4), np.float32)
    last[:6, 0] = -200
    hidden = [Dense(jnp.asarray(k), jnp.zeros(16)) for k in (first, second)]
    bias = jnp.array([120.0, 0, 0, 0])
    # sigmoid(0) is an albedo and a roughness of a half; no gloss
    dull = grey._replace(last=Dense(grey.last.kernel, jnp.array([0.0, 0, 0, 0, -40])))
    return made._replace(sigma=made.sigma._replace(hidden=hidden, last=Dense(jnp.asarray(last), bias)), texture=dull)


def normalised(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x)


def outward(found, o, d) -> np.ndarray:
    """Directions from the middle of the box to where rays end."""
    n = o + found.depth.reshape(-1, 1) * d
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)


def test_a_flash_lights_what_the_camera_sees(stone) -> None:
    """By the closed form at the surface, albedo/π · cos · flash/t²; the march that training sees agrees with it."""
    found = picture(LIT, stone, PHOTO, View(EXACT.with_changes(samples=256), FULL))
    o, d = photo_rays(PHOTO, pixels(PHOTO))
    cosine = np.einsum("ij,ij->i", outward(found, o, d), -d)
    wanted = 0.5 / np.pi * cosine * 4.0 / np.maximum(found.depth.ravel(), 1) ** 2
    hit = (found.rgba[..., 3].ravel() > 0.999) & (cosine > 0.1)
    assert hit.sum() > 20
    np.testing.assert_allclose(found.rgba.reshape(-1, 4)[hit, 0], wanted[hit], rtol=0.03)
    rays = (jnp.asarray(x, jnp.float32) for x in (o, d))
    each = jax.jit(jax.vmap(lambda o, d: march(LIT, stone, o, d, FULL, jnp.full(256, 0.5))))(*rays)
    np.testing.assert_allclose(found.rgba.reshape(-1, 4)[:, :3], each.colour, atol=1e-4)


def test_what_reflects_and_is_seen_from_behind_is_counted(stone) -> None:
    """A normal that all of a ray sees at one angle, by the closed form (1 − T) max(cos, 0)²; colours alone have none."""
    o, d = jnp.array([0.1, 0.05, -2.5]), jnp.array([0.0, 0.0, 1.0])
    marched = jax.jit(lambda config, field: march(config, field, o, d, FULL, jnp.full(64, 0.5)), static_argnums=0)
    for cosine in (1.0, 0.6, 0.0, -0.6):
        n = jnp.array([0.0, (1 - cosine**2) ** 0.5, cosine]) * 1e4  # so long that the place in the box adds nothing
        last = stone.sigma.last
        tilted = stone._replace(sigma=stone.sigma._replace(last=last._replace(bias=last.bias.at[1:].set(n))))
        found = marched(LIT, tilted)
        assert found.passed < 1e-3
        np.testing.assert_allclose(found.away, (1 - found.passed) * max(cosine, 0) ** 2, rtol=1e-3, atol=1e-6)
    assert marched(CONFIG, init_field(CONFIG, jax.random.key(0))).away == 0


def test_a_distant_light_and_its_shadow(stone) -> None:
    """What faces the light is lit by its cosine; what faces away is black; and the object blocks a light behind it."""
    toward = np.array([0.0, 0.8, 0.6])
    lit = Lighting((Distant(toward, np.full(3, 2.0)),), None)
    found = picture(LIT, stone, PHOTO, View(EXACT.with_changes(samples=256), FULL, None, lit))
    cosine = outward(found, *photo_rays(PHOTO, pixels(PHOTO))) @ toward
    hit = found.rgba[..., 3].ravel() > 0.999
    shown = found.rgba.reshape(-1, 4)[:, 0]
    bright, flat, dark = hit & (cosine > 0.6), hit & (cosine > 0.15) & (cosine < 0.6), hit & (cosine < -0.1)
    assert bright.sum() > 5 and flat.sum() > 5 and dark.sum() > 3
    np.testing.assert_allclose(shown[bright], 0.5 / np.pi * cosine[bright] * 2.0, rtol=0.1)
    # what is hit flat lies in no shadow of its own fog
    np.testing.assert_allclose(shown[flat], 0.5 / np.pi * cosine[flat] * 2.0, rtol=0.2)
    assert shown[dark].max() < 1e-3
    behind = Lighting((Distant(-toward, np.full(3, 2.0)),), None)
    assert picture(LIT, stone, PHOTO, View(EXACT, FULL, None, behind)).rgba[..., 0].ravel()[bright].max() < 1e-3


def test_an_even_sky_lights_it_as_a_furnace(stone) -> None:
    """Under radiance 1 from everywhere a convex matt thing shows its albedo, but for noise and Schlick's rim."""
    sky = environment(np.ones((8, 16, 3), np.float32), 2)
    view = View(EXACT.with_changes(samples=32, environment_samples=16), FULL, None, Lighting((), sky))
    found = picture(LIT, stone, PHOTO, view)
    hit = found.rgba[..., 3] > 0.999
    assert found.rgba[hit][:, 0].mean() == pytest.approx(0.5, abs=0.06)


def test_albedo_is_what_is_painted(stone) -> None:
    assert texture_image(captured(stone, LIT), "square", 16) == pytest.approx(0.5, abs=1e-5)
    half = paint_of(captured(stone, LIT), "square", np.full((16, 16, 3), 0.5, np.float32), "multiply")
    plain, found = (picture(LIT, stone, PHOTO, View(EXACT, FULL, paint)).rgba[..., 0] for paint in (None, half))
    np.testing.assert_allclose(found, plain / 2, rtol=0.03, atol=1e-5)


def test_roughness_is_written_as_it_is(stone, tmp_path) -> None:
    """As an image of the texture, and in the channel that glTF has for it."""
    last = stone.texture.last
    stone = stone._replace(texture=stone.texture._replace(last=last._replace(bias=jnp.array([0.0, 0, 0, 1, -1]))))
    rough = texture_image(captured(stone, LIT), "cubemap", 16, "roughness")
    at = directions("cubemap", 16)[5, 7]
    wanted = lobes(LIT, stone, jnp.asarray(at))
    np.testing.assert_allclose(rough[5, 7], float(wanted.roughness), atol=1e-6)
    np.testing.assert_allclose(
        texture_image(captured(stone, LIT), "cubemap", 16, "specular")[5, 7], float(wanted.specular), atol=1e-6
    )
    found = extract_mesh(LIT, stone, 4, 16)
    image = texture_image(captured(stone, LIT), "cubemap", 16)
    write_textured_mesh(tmp_path / "a.glb", found.vertices, found.faces, found.uv, found.normals, image, rough[..., 0])
    made: Any = trimesh.load_mesh(tmp_path / "a.glb")
    kept = np.asarray(made.visual.material.metallicRoughnessTexture, np.float64)[..., :3] / 255
    np.testing.assert_allclose(kept[..., 1], rough[..., 0], atol=0.5 / 255 + 1e-6)
    assert (kept[..., 2] == 0).all()


@pytest.mark.parametrize("name", ["a.glb", pytest.param("a.obj", marks=pytest.mark.slow)])
def test_a_files_texture_lies_where_the_map_says(field, tmp_path, name) -> None:
    """Colours found through the file's coordinates are those of the image at each vertex's direction; welded, it is closed."""
    found = extract_mesh(CONFIG, field, 8, 64)
    smooth = np.clip(0.5 + 0.4 * directions("cubemap", 64), 0, 1)
    write_textured_mesh(tmp_path / name, found.vertices, found.faces, found.uv, found.normals, smooth)
    mesh: Any = trimesh.load_mesh(tmp_path / name)
    colours = srgb_to_linear(mesh.visual.to_color().vertex_colors[:, :3].astype(np.float32) / 255)
    near = np.linalg.norm(mesh.vertices[:, None] - found.vertices[None], axis=-1).argmin(axis=1)
    np.testing.assert_allclose(colours, 0.5 + 0.4 * found.u[near], atol=0.03)
    if name == "a.obj":
        rows = [line.split()[1:] for line in (tmp_path / name).read_text().splitlines() if line.startswith("vn ")]
        np.testing.assert_allclose(np.array(rows, float), found.normals, atol=1e-5)
    else:
        data = (tmp_path / name).read_bytes()
        length = int.from_bytes(data[12:16], "little")
        said = json.loads(data[20 : 20 + length])
        accessor = said["accessors"][said["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]]
        begin = 28 + length + said["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        kept = np.frombuffer(data, np.float32, 3 * accessor["count"], begin).reshape(-1, 3)
        np.testing.assert_allclose(kept, found.normals, atol=1e-5)
    loaded = load_mesh(tmp_path / name)
    assert len(loaded.vertices) == 6 * 8**2 + 2 and len(loaded.faces) == 12 * 8**2
