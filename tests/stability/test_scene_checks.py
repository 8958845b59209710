"""`mesoshell stability`: checks hold on sound scenes, and each of them is broken by what it looks for."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.geometry.mesh import check_mesh, load_mesh
from mesoshell.geometry.normals import face_normals
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import read_png
from mesoshell.scene.materials import Material
from mesoshell.scene.render_shell import marched_scene
from mesoshell.scene.setup import describe_shell
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.render.scene import Scene as MarchedScene
from mesoshell.stability import examine, field, surface, walks
from mesoshell.stability.checks import Check
from mesoshell.stability.prisms import invert_prism, least_jacobian, prism_point
from mesoshell.stability.rays import FAR, FRONT, NEAR, aim_rays, at_the_front, grazing
from mesoshell.stability.walks import Walked
from tests.helpers import scenes, wearing

DATA = Path(__file__).parents[1] / "data"
SUZANNE = load_mesh(DATA / "suzanne.obj")
SHELL = extrude(SUZANNE, 0.1, 0.1)
TOLD = {"mesh", "thickness", "chart", "coordinates", "16 bits", "skipping"}


@pytest.fixture(scope="module")
def walked() -> Walked:
    some = aim_rays(SHELL, 1000, NEAR, np.random.default_rng(0))
    boundary = Boundary(SHELL, SUZANNE.faces)
    return Walked(some, boundary.trace(some.o, some.d), boundary.trace(some.o, some.d, exact=True))


@pytest.fixture(scope="module")
def scene(tiny_bundle: Bundle) -> ms.Scene:
    return ms.Scene(SUZANNE, Material("tiny", tiny_bundle), thickness=0.1, size=(48, 32))


@pytest.fixture(scope="module")
def sound(scene: ms.Scene):
    return ms.stability(scene, rays=1000)


def test_a_sound_scene(sound) -> None:
    assert sound.broken == () and {c.name for c in sound.checks if c.limit is None} == TOLD
    lines = str(sound).splitlines()
    assert len(lines) == len(sound.checks) and all(line.startswith(("ok  ", "    ")) for line in lines)
    assert "967 faces; 1 repeated face dropped" in lines[0]
    assert sound.first.shape == (32, 48) and 0 < (sound.first >= 0).mean() < 1
    assert sound.kept.max() == pytest.approx(1) and sound.kept.min() < 0.5 and sound.excess.max() < 50


def test_nothing_depends_on_the_unit_of_length(sound, tiny_bundle: Bundle) -> None:
    """By a power of two, nearly all rounding is the same."""
    large = check_mesh(SUZANNE.vertices * 1024, SUZANNE.faces, SUZANNE.uv, "mesh")
    found = ms.stability(ms.Scene(large, Material("tiny", tiny_bundle), thickness=102.4, size=(48, 32)), rays=1000)
    for a, b in zip(found.checks[1:], sound.checks[1:], strict=True):
        assert a.name == b.name and a.limit == (b.limit and pytest.approx(b.limit, rel=0.02)), a.name
        assert a.worst == pytest.approx(b.worst, rel=0.1, abs=1e-6), a.name


def test_an_open_mesh_that_the_camera_does_not_see(tiny_bundle: Bundle) -> None:
    """Two triangles, so no vertex or edge with faces all around; an object beside them; a parameter that varies."""
    square, age = scenes.slab_mesh(), np.linspace(0, 1, 16, dtype=np.float32).reshape(4, 4)
    lid = check_mesh(square.vertices + np.array([0, 0, 3]), square.faces, square.uv, "lid")
    away = (0.5, 0.5, 5.0, 0.5, 0.5, 9.0, 40.0)
    scene = ms.Scene(square, Material("tiny", tiny_bundle), 0.1, 0.5, {"dryness": age}, camera=away, objects=[lid])
    found = ms.stability(replace(scene, size=(24, 16)), rays=1000)
    assert found.broken == () and (found.first < 0).all() and found.map().startswith(b"\x89PNG")
    assert "0 of 0 rays at the front" not in str(found) and "the camera does not see the shell" in str(found)


@pytest.mark.parametrize("engine", ["jax", "mitsuba"])
def test_each_of_several_materials_is_checked_and_all_are_walked(
    scene: ms.Scene, tiny_bundle: Bundle, engine: Literal["jax", "mitsuba"]
) -> None:
    """One of them has a density that is not finite."""
    bias = tiny_bundle.arrays["decoder/sigma/bias"] * np.float32(np.nan)
    bad = replace(tiny_bundle, arrays=tiny_bundle.arrays | {"decoder/sigma/bias": bias})
    square = scenes.slab_mesh()
    lid = check_mesh(square.vertices + np.array([-3, 1, 7]), square.faces, square.uv, "lid")
    two = replace(scene, also=(ms.Grown(lid, Material("other", bad), thickness=0.2),))
    found = ms.stability(two, rays=1000, engine=engine)
    own = [check for check in found.checks if check.name in ("mesh", "offset", "sides", "material", "network")]
    assert [c.said.split(": ")[0] for c in own] == ["tiny"] * 3 + ["other"] * 3 + ["tiny"] * 2 + ["other"] * 2
    assert {"material", "network"} <= {c.name for c in found.broken if c.said.startswith("other: ")}
    assert not [c for c in found.broken if c.said.startswith("tiny: ")]
    assert (
        found.kept is not None
        and len(found.kept) == len(found.excess) == 967 + len(lid.faces)
        and found.kept.max() == pytest.approx(1)
    )


def test_the_path_tracer_walks_and_renders_too(scene: ms.Scene, sound, monkeypatch: pytest.MonkeyPatch) -> None:
    """As small a picture as the map, also of a camera that has a size of its own."""
    camera = describe_shell(scene, lambda share: None).camera
    monkeypatch.setattr(examine, "PIXELS", 48)
    own = replace(scene, camera=replace(camera, width=96, height=64))
    found = ms.stability(own, rays=1000, engine="mitsuba")
    *rest, paths, radiance = found.checks
    assert found.broken == () and paths.name == "paths"
    assert [c.name for c in (*rest, radiance)] == [c.name for c in sound.checks]
    assert found.picture.shape == sound.picture.shape and np.abs(found.picture - sound.picture).mean() > 1e-3


def test_a_walk_of_the_path_tracer_that_is_short_is_seen(scene: ms.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    from mesoshell.stability import paths

    made, rng = marched_scene(describe_shell(scene, lambda share: None)), np.random.default_rng(0)
    assert paths.of_walk(made, 0.1, 2000, rng).worst <= paths.OTHER
    whole = paths.Shells
    monkeypatch.setattr(paths, "Shells", lambda shells: whole([replace(s, offset=0.98 * s.offset) for s in shells]))
    check = paths.of_walk(made, 0.1, 2000, rng)
    assert check.broken and check.worst > 0.5 and not check.said.startswith("0 of")
    monkeypatch.setattr(paths, "lengths", lambda shells, o, d, end: np.full(len(o), np.nan))
    assert paths.of_walk(made, 0.1, 2000, rng).worst == 1


def test_the_path_tracer_holds_nothing_out(scene: ms.Scene) -> None:
    with pytest.raises(ms.InputError, match="objects are held out by `engine` jax alone"):
        ms.stability(replace(scene, holdout=True), rays=1000, engine="mitsuba")


def test_a_mesh_far_from_the_origin() -> None:
    assert not surface.of_grid(SHELL.base, 0.1).broken
    check = surface.of_grid(SHELL.base + np.float32(1e4), 0.1)
    assert check.broken and check.worst == pytest.approx(2**-10 / 0.1)


def test_folds() -> None:
    """Posts of the thickness that was asked for, without what `extrude` takes away."""
    post = 0.1 * SHELL.offset / np.linalg.norm(SHELL.offset, axis=1, keepdims=True)
    check = surface.of_folds(replace(SHELL, offset=post))
    assert check.broken and check.worst == (least_jacobian(replace(SHELL, offset=post)) <= 0).sum() > 50
    assert not surface.of_folds(SHELL).broken


def test_thickness_and_chart_are_told() -> None:
    said = surface.of_thickness(SHELL, 0.1, len(SUZANNE.faces) + 2).said
    assert said.startswith("169 of 509 vertices thinned, to 0.033 at least")
    assert said.endswith("; 2 faces without a prism")
    turned = replace(SHELL, uv=SHELL.uv * np.array([-1, 1], np.float32))
    assert surface.of_chart(turned).said.endswith(f"{len(SHELL.faces)} prisms mirrored, 0 without area in UV")
    flat = replace(SHELL, uv=np.zeros_like(SHELL.uv))
    assert (
        surface.of_chart(flat).said
        == f"seams along 0.0% of inner edges; 0 prisms mirrored, {len(SHELL.faces)} without area in UV"
    )


def test_a_side_that_is_wrong_and_not_in_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    right = surface.of_sides(SHELL, np.random.default_rng(0))
    assert not right.broken and "the textbook's quadratic would miss 0." in right.said

    def off(*given):
        found = surface.leave_side(*given)
        return found._replace(u=found.u + 0.01)

    monkeypatch.setattr(surface, "_left", _with(off))
    assert surface.of_sides(SHELL, np.random.default_rng(0)).worst > 0.9 * 3 * len(SHELL.faces)


def _with(crossing):
    """`surface._left` with another `leave_side`."""
    import jax

    def left(d, p, n):
        f = jax.vmap(jax.vmap(surface.post_function, in_axes=(None, 0, 0)))(d, p, n)
        found = jax.vmap(crossing)(d, p, n, f)
        return jnp.stack([found.u, found.h], axis=1), found.inside, found.doubt, found.u

    return jax.jit(left)


def test_rays_are_aimed_at_what_they_say() -> None:
    rng = np.random.default_rng(3)
    some = aim_rays(SHELL, 500, NEAR, rng)
    known = np.isfinite(some.reach)
    x = (some.o + NEAR * _size() * some.d)[known]
    _, _, left = invert_prism(SHELL, some.prism[known], x)
    assert 0.3 < known.mean() <= 0.4 and left.max() < 1e-9
    np.testing.assert_allclose(some.reach[known], NEAR * _size())
    front = at_the_front(SUZANNE, 500, rng)
    at = front.o + front.surface[:, None] * front.d
    near = np.linalg.norm(SUZANNE.vertices[None] - at[:, None], axis=2).min(axis=1)
    assert 0.3 < (near < 1e-9).mean() < 0.7 and len(at) > 300
    low = grazing(SHELL, 50, 1e-3, rng)
    top = (SHELL.base.astype(np.float64) + SHELL.offset)[SHELL.faces[low.prism]]
    normal = np.cross(top[:, 1] - top[:, 0], top[:, 2] - top[:, 0])
    sine = np.einsum("ri,ri->r", normal, low.d) / np.linalg.norm(normal, axis=1)
    np.testing.assert_allclose(sine, -1e-3, rtol=1e-5)
    v = SUZANNE.vertices.astype(np.float64)
    normal = face_normals(v, SUZANNE.faces)
    for x, d in zip(at[near < 1e-9][:50], front.d[near < 1e-9][:50], strict=True):
        around = (np.linalg.norm(v[SUZANNE.faces] - x, axis=2) < 1e-9).any(axis=1)
        assert (normal[around] @ d).max() < -FRONT


def _size() -> float:
    return float(np.ptp(np.concatenate([SHELL.base, SHELL.base + SHELL.offset]), axis=0).max())


def test_a_ray_is_the_same_from_however_far() -> None:
    """From 1000 sizes away, and begun near: the origins are the same points of the same rays in float64."""
    far = aim_rays(SHELL, 5000, FAR, np.random.default_rng(2))
    boundary, along = Boundary(SHELL, SUZANNE.faces), (FAR - NEAR) * _size()
    there = boundary.trace(far.o, far.d)
    here = boundary.trace(far.o + along * far.d, far.d, exact=True)
    moved = here.intervals._replace(t0=here.intervals.t0 + along, t1=here.intervals.t1 + along)
    here = here._replace(end=here.end + along, intervals=moved)
    assert walks.differences(Walked(far, there, here), 0.1).max() < 1e-4


def test_what_leaks_is_seen(walked: Walked) -> None:
    assert not walks.leaks(walked, 1e-5).any()
    i = walked.trace.intervals
    without = walked._replace(trace=walked.trace._replace(intervals=type(i)(*(x[:0] for x in i))))
    reached = np.isfinite(walked.rays.reach) & (walked.trace.end > walked.rays.reach + 1e-5)
    np.testing.assert_array_equal(walks.leaks(without, 1e-5), reached)
    assert reached.sum() > 100


def test_a_ray_that_passes_the_surface_is_seen() -> None:
    some = at_the_front(SUZANNE, 500, np.random.default_rng(1))
    trace = Boundary(SHELL, SUZANNE.faces).trace(some.o, some.d)
    assert not walks.passing(Walked(some, trace, trace), 1e-5).any()
    through = trace._replace(end=np.full(len(some.d), np.inf))
    assert walks.passing(Walked(some, through, trace), 1e-5).all()


def test_an_interval_in_a_wrong_prism_is_seen(walked: Walked) -> None:
    rng = np.random.default_rng(0)
    right = walks.middles(SHELL, walked, 0.1, rng)
    assert right.outside.max() < 1e-4 and len(right.prism) == len(walked.trace.intervals.ray)
    i = walked.trace.intervals
    other = walked._replace(trace=walked.trace._replace(intervals=i._replace(prism=(i.prism + 400) % len(SHELL.faces))))
    assert (walks.middles(SHELL, other, 0.1, rng).outside > 1e-3).mean() > 0.99


def test_a_crossing_that_is_off_is_seen(walked: Walked) -> None:
    assert walks.joins(SHELL, walked, 0.1)[1].max() < 1e-5
    i = walked.trace.intervals
    for moved in (i._replace(h1=i.h1 + 0.01), i._replace(h0=i.h0 + 0.01)):
        changed = walked._replace(trace=walked.trace._replace(intervals=moved))
        assert np.median(walks.joins(SHELL, changed, 0.1)[1]) == pytest.approx(0.01, rel=0.2)


def test_a_precision_that_is_not_enough_is_seen(walked: Walked) -> None:
    assert walks.differences(walked, 0.1).max() < 1e-4
    i = walked.trace.intervals
    longer = walked._replace(trace=walked.trace._replace(intervals=i._replace(t0=i.t0 - 0.001)))
    assert walks.differences(longer, 0.1).max() > 0.01


@pytest.mark.parametrize(
    ("damage", "broken"),
    [
        ({}, set()),
        ({"rho": np.nan}, {"material", "network"}),
        ({"sigma": np.nan}, {"material", "network"}),
    ],
)
def test_a_network_that_gives_nonsense(damage: dict, broken: set, tiny_bundle: Bundle) -> None:
    scene: MarchedScene = scenes.slab(tiny_bundle)
    decoder = scene.device_material.material.decoder
    for name, value in damage.items():
        layer = getattr(decoder, name)
        decoder = decoder._replace(**{name: layer._replace(bias=layer.bias.at[0].set(value))})
    device_material = replace(scene.device_material, material=scene.device_material.material._replace(decoder=decoder))
    found = field.check_material_points(
        replace(scene, device_material=device_material).media[0], scene.shell.uv, np.random.default_rng(0)
    )
    assert {check.name for check in found if check.broken} == broken


def test_inversion_is_of_the_map() -> None:
    rng = np.random.default_rng(0)
    prism, bary, h = rng.integers(0, 967, 300), rng.dirichlet((1, 1, 1), 300)[:, :2], rng.uniform(size=300)
    found = invert_prism(SHELL, prism, prism_point(SHELL, prism, bary, h))
    for a, b in zip(found, (bary, h, 0), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_nan_breaks_a_bound_and_nothing_breaks_what_is_told() -> None:
    assert Check("a", "b", float("nan"), 1.0).broken and not Check("a", "b", float("nan"), None).broken
    assert str(Check("a", "b", 2.0, 1.0)) == "BAD a           b (at most 1)" and not Check("a", "b", 1.0, 1.0).broken


@pytest.fixture
def tiny(tiny_bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    return ["stability", "--material", "tiny.npz", "--size", "48", "32", "--rays", "1000"]


def test_the_command(tiny: list[str], capsys) -> None:
    main([*tiny, str(DATA / "suzanne.obj"), "--thickness", "0.1", "--out", "new/map.png"])
    *lines, last = capsys.readouterr().out.splitlines()
    told = json.loads(Path("new/map.json").read_text())["checks"]
    assert last == "new/map.png" and read_png("new/map.png").std() > 0.1
    assert [line[4:16].strip() for line in lines] == [check["name"] for check in told]
    assert not any(check["broken"] for check in told)


def test_a_broken_bound_is_exit_status_1(tiny: list[str], capsys) -> None:
    text = (DATA / "suzanne.obj").read_text().splitlines()
    far = [f"v {float(x.split()[1]) + 30000} {' '.join(x.split()[2:])}" if x.startswith("v ") else x for x in text]
    Path("far.obj").write_text("\n".join(far))
    with pytest.raises(SystemExit) as stop:
        main([*tiny, "far.obj"])
    assert stop.value.code == 1 and "BAD offset" in capsys.readouterr().out
    assert Path("out/stability.png").exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--rays", "10"], "--rays: must be at least 1000, not 10"),
        (["--out", "a.jpg"], "a.jpg: must end in .png"),
        (["--out", "."], ".: must end in .png"),
        (
            ["--material", "dots.npz", "--thickness", "1"],
            "--thickness: dots.npz is a surface material: it has none (see --scale)",
        ),
        (["--thickness", "-1"], "--thickness: must be positive and finite, not -1"),
    ],
)
def test_faults_are_one_line(given: list[str], said: str, tiny: list[str], capsys) -> None:
    from mesoshell.io.surface import write_surface

    write_surface("dots.npz", wearing.bundle())
    before = sorted(Path().iterdir())
    with pytest.raises(SystemExit) as stop:
        main([*tiny, str(DATA / "suzanne.obj"), *given])
    assert stop.value.code == 2 and capsys.readouterr().err == f"mesoshell: {said}\n"
    assert [p for p in sorted(Path().iterdir()) if p.name != "cache"] == [p for p in before if p.name != "cache"]
