"""A shell that teaches: places and frames on cylinders against their maps in float64, and rays through fog by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.datasets.queries.tile import PatchPlacement, bent
from mesoshell.io.bundle import read_bundle
from mesoshell.io.material import find
from mesoshell.shell.material.field import Field, Layout
from mesoshell.shell.material.loader import load_device_material
from mesoshell.train.surface import shell_teacher
from mesoshell.train.surface.shell_teacher import (
    BATCH,
    SAMPLES,
    DevicePlacement,
    LocalQuery,
    Teacher,
    answer,
    answers,
    frame,
    span,
)

DEPTH = 0.4
TURN, SHIFT, PLACE = 0.7, np.array([0.3, -0.2]), np.array([0.1, 0.25])


def rotation(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def placement(curvature: float) -> DevicePlacement:
    return DevicePlacement(*(jnp.asarray(x, jnp.float32) for x in (curvature, rotation(TURN), SHIFT)))


def teacher(base: float = 0.0) -> Teacher:
    nothing: jnp.ndarray = jnp.zeros(0, jnp.float32)
    return Teacher(None, nothing, jnp.asarray(DEPTH, jnp.float32), jnp.full(3, base, jnp.float32))  # type: ignore[arg-type]


def fog(sigma: float, rho: float) -> Field:
    """One density and one ρ everywhere."""
    return Field(
        lambda point: (jnp.asarray(sigma, jnp.float32), jnp.zeros(1, jnp.float32)),
        lambda found, w, light: jnp.full(3, rho, jnp.float32),
    )


def unit(*x: float) -> np.ndarray:
    return np.array(x) / np.linalg.norm(x)


def asked(cosine: float, light: np.ndarray, side: float = 1.0) -> LocalQuery:
    toward = np.array([side * np.sqrt(1 - cosine**2), 0, cosine])
    return LocalQuery(*(jnp.asarray(x, jnp.float32) for x in (PLACE, 0.002, toward, light)))


def world(xi: np.ndarray, curvature: float) -> np.ndarray:
    """The shell's map in float64: from (u, v, h) to the frame of PLACE."""
    sy = (xi[:2] - SHIFT) @ rotation(TURN) - PLACE
    return bent(sy, np.asarray((xi[2] - 1) * DEPTH), curvature)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([0.0, 1e-6, 1e-3, -0.3, 0.5, -1.0, 2.0]),
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
    st.floats(0.02, 0.98),
)
def test_places_and_frames_are_those_of_the_shells_map(curvature, s, y, h) -> None:
    xi = np.append(rotation(TURN) @ (PLACE + np.array([s, y])) + SHIFT, h)
    p = world(xi, curvature)
    found, inverse = frame(
        jnp.asarray(DEPTH), placement(curvature), jnp.asarray(PLACE, jnp.float32), jnp.asarray(p, jnp.float32)
    )
    np.testing.assert_allclose(found, xi, atol=3e-6)
    jacobian = np.stack(
        [(world(xi + d, curvature) - world(xi - d, curvature)) / 2e-5 for d in 1e-5 * np.eye(3)], axis=1
    )
    np.testing.assert_allclose(np.asarray(inverse, np.float64) @ jacobian, np.eye(3), atol=2e-5)


@pytest.mark.parametrize("curvature", [0.0, 1e-6, 0.3, 1.5, -0.8])
@pytest.mark.parametrize("cosine", [0.03, 0.2, 0.5, 0.9, 1.0])
def test_a_ray_ends_where_it_meets_the_body_or_leaves(curvature, cosine) -> None:
    """Against the heights of many points on the ray."""
    end, met = span(*(jnp.asarray(x, jnp.float32) for x in (curvature, DEPTH, cosine)))
    t = np.linspace(0, 1.2 * float(end), 200_001)[1:]
    points = -t[:, None] * np.array([np.sqrt(1 - cosine**2), 0, cosine])
    k = curvature
    square = points[:, 0] ** 2 + points[:, 2] ** 2
    reach = np.sqrt((k * points[:, 0]) ** 2 + (1 + k * points[:, 2]) ** 2)
    height = (k * square + 2 * points[:, 2]) / (1 + reach)
    out = (height <= -DEPTH) | (height >= 0)
    first = np.argmax(out)
    assert out.any() and abs(t[first] - float(end)) < 1e-4 * float(end) + 2 * t[0]
    assert bool(met) == (height[first] <= -DEPTH)
    grazing = np.sqrt(max(k * DEPTH * (2 - k * DEPTH), 0))
    assert bool(met) == (cosine >= grazing)


@pytest.mark.parametrize("cosine", [0.3, 0.8])
def test_fog_on_a_plane(cosine) -> None:
    """ρ (1 − T), and what the surface beneath reflects through fog on both ways; by hand."""
    sigma, rho, base, light = 1.5, 0.02, 0.5, unit(0.3, -0.4, 0.8)
    found = answer(fog(sigma, rho), teacher(base), placement(0.0), asked(cosine, light))
    # canonical lengths: along ω through a slab DEPTH thick whose unit of height is DEPTH
    along = np.hypot(DEPTH * np.sqrt(1 - cosine**2) / cosine, 1.0)
    through = np.exp(-sigma * along)
    bent_light = unit(light[0], light[1], light[2] / DEPTH)
    beneath = base / np.pi * light[2] * np.exp(-sigma / bent_light[2])
    np.testing.assert_allclose(found[:3], rho * (1 - through) + through * beneath, rtol=2e-5)
    assert found[3] == 1


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_fog_past_a_silhouette(side) -> None:
    """A ray that leaves again is as opaque as its canonical length says; nothing beneath is seen."""
    curvature, cosine, sigma, rho = 1.0, 0.3, 2.0, 0.1
    found = answer(fog(sigma, rho), teacher(1.0), placement(curvature), asked(cosine, unit(0, 0, 1), side))
    t = (np.arange(4096) + 0.5) / 4096 * 2 * cosine / curvature
    p = -t[:, None] * np.array([side * np.sqrt(1 - cosine**2), 0, cosine])
    axis = np.array([0, 0, -1 / curvature])
    reach = np.linalg.norm(p - axis, axis=1)
    outward = (p - axis) / reach[:, None]
    d = -np.array([side * np.sqrt(1 - cosine**2), 0, cosine])
    up = outward @ d
    across = np.sqrt(1 - up**2) / (curvature * reach)
    length = np.sqrt((up / DEPTH) ** 2 + across**2).mean() * t[-1] * 4096 / 4095.5
    alpha = 1 - np.exp(-sigma * length)
    np.testing.assert_allclose(found[3], alpha, rtol=2e-3)
    np.testing.assert_allclose(found[:3], rho * alpha, rtol=2e-3)


def test_the_texture_lies_turned_and_shifted() -> None:
    """A field that is dense in one place alone is met where the map says."""
    xi = np.array([0.62, 0.31, 0.5])
    for curvature in (0.0, 0.9, -0.7):
        p = world(xi, curvature)
        toward = unit(0.4, 0, 0.9)
        # the ray against `toward` that passes p enters the bounding surface at some s; ask from there
        t = np.linspace(0, 3, 300_001)
        k = curvature
        q = p + t[:, None] * toward
        height = (k * (q[:, 0] ** 2 + q[:, 2] ** 2) + 2 * q[:, 2]) / (
            1 + np.sqrt((k * q[:, 0]) ** 2 + (1 + k * q[:, 2]) ** 2)
        )
        entry = q[np.argmax(height >= 0)]
        angle = np.arctan2(k * entry[0], 1 + k * entry[2])
        s = angle / k if k else entry[0]
        turned = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])

        def density(point):
            near = jnp.abs(point.xi - jnp.asarray(xi, jnp.float32)).max() < 1.5 * 3 / SAMPLES
            return jnp.where(near, 1e4, 0.0), jnp.zeros(1, jnp.float32)

        field = Field(density, fog(0, 1.0).transport)
        columns = (PLACE + np.array([s, entry[1]]), 0.002, turned @ toward, unit(0, 0, 1))
        local = LocalQuery(*(jnp.asarray(x, jnp.float32) for x in columns))
        hit = jax.jit(lambda l, k=curvature, f=field: answer(f, teacher(), placement(k), l))(local)
        missed = answer(field, teacher(), placement(curvature), local._replace(place=local.place + 0.2))
        np.testing.assert_allclose(hit[:3], 1, rtol=1e-4)
        np.testing.assert_allclose(missed[:3], 0, atol=1e-6)


def test_a_footprint_is_about_the_place_on_the_surface(monkeypatch) -> None:
    """However flat a ray is: three quarters of the variance are the filter's, one quarter is where rays are marched."""
    seen: list[LocalQuery] = []
    monkeypatch.setattr(
        shell_teacher, "_taught", lambda layout, teacher, placement, part: seen.append(part) or np.zeros((BATCH, 4))
    )
    n = 3 * BATCH - 5
    columns = {
        "place": np.tile(PLACE, (n, 1)),
        "radius": np.full(n, 0.5),
        "toward": np.tile(unit(1, 0, 0.05), (n, 1)),
        "light": np.tile(unit(0, 0, 1), (n, 1)),
    }
    of = answers(Layout(((1, 1),), ((1, 1),), 1.0, 0), teacher())
    drawn = []
    for seed in (0, 0, 1):
        seen.clear()
        found, _ = of(PatchPlacement(0.5, TURN, (0.3, -0.2)), columns, seed)
        assert found["alpha"].shape == (n, 1) and found["reflectance"].shape == (n, 3)
        drawn.append(np.concatenate([part.place for part in seen])[:n])
        np.testing.assert_allclose(np.concatenate([part.radius for part in seen]), 0.5 * np.sqrt(0.75), rtol=1e-6)
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert np.abs(drawn[2] - drawn[0]).min(axis=0).max() > 0
    np.testing.assert_allclose(np.cov(drawn[0].T), 0.0625 * np.eye(2), atol=0.01)
    np.testing.assert_allclose(drawn[0].mean(axis=0), PLACE, atol=0.02)


@pytest.mark.parametrize("degrees", [*(pytest.param(x, marks=pytest.mark.slow) for x in (0, 25, 50)), 75])
def test_grass_seen_wide_is_the_mean_of_grass_seen_narrow(degrees: float):
    """The bundled grass, by footprints of a patch and of a texel: one that mixed heights was 4 to 7 times too bright."""
    bundle = read_bundle(find("grass"))
    held = load_device_material(bundle)
    alpha, base = jnp.full(len(held.names), 0.2, jnp.float32), jnp.float32([0.09, 0.06, 0.035])
    ask = answers(held.layout, Teacher(held.material, alpha, jnp.asarray(0.5, jnp.float32), base))
    n, random = 2048, np.random.default_rng(0)
    slope = np.radians(degrees)

    def seen(radius: float) -> np.ndarray:
        queries = {
            "place": random.uniform(-0.5, 0.5, (n, 2)),
            "radius": np.full(n, radius),
            "toward": np.tile([np.sin(slope), 0, np.cos(slope)], (n, 1)),
            "light": np.tile(unit(0.3, 0.2, 0.8), (n, 1)),
        }
        return ask(PatchPlacement(0.0, TURN, (0.0, 0.0)), queries, 0)[0]["reflectance"].mean(axis=0)

    np.testing.assert_allclose(seen(1.0), seen(1 / 256), rtol=0.3)


@pytest.mark.slow
def test_of_corner_tiles_each_placement_shows_a_patch_of_its_own(tiny_bundle, tiled_bundle) -> None:
    """At one place within it, to a thousandth: as many answers as tiles; one where a patch repeats. And one a placement."""
    query = {
        "place": np.zeros((1, 2)),
        "radius": np.zeros(1),
        "toward": np.array([[0.0, 0.0, 1.0]]),
        "light": np.array([[0.6, 0.0, 0.8]]),
    }
    random = np.random.default_rng(0)
    placings = [PatchPlacement(0.0, 0.0, tuple(0.4 + 1e-3 * random.random(2))) for _ in range(40)]
    numbers = []
    for bundle in (tiny_bundle, tiled_bundle):
        loaded = load_device_material(bundle)
        taught = Teacher(loaded.material, jnp.full(1, 0.5), jnp.asarray(DEPTH, jnp.float32), jnp.full(3, 0.1))
        ask = answers(loaded.layout, taught)
        seen = [ask(placing, query, seed)[0]["reflectance"][0, 1] for seed, placing in enumerate(placings)]
        np.testing.assert_array_equal(seen[:5], [ask(p, query, 9)[0]["reflectance"][0, 1] for p in placings[:5]])
        numbers.append(1 + int((np.diff(np.sort(seen)) > 0.02 * np.mean(seen)).sum()))
    assert numbers[0] == 1 and 6 <= numbers[1] <= 16
