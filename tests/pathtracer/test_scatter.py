"""Directions are drawn with the density that they say; collisions with the weights that quadrature gives them."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.io.bundle import read_bundle
from mesoshell.pathtracer import scatter
from mesoshell.pathtracer.direct import gather_light
from mesoshell.pathtracer.free_flight import fly
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.media import Media, Medium
from mesoshell.pathtracer.render_context import RenderContext
from mesoshell.pathtracer.samples import IntervalFrame, Ray, canonical, no_frame
from mesoshell.pathtracer.shells import Shells
from mesoshell.render.effects import PATHS, plan_effects
from mesoshell.render.facts import Facts
from mesoshell.shell.geometry.extrude import extrude
from tests.helpers.path_traced import AGE, QUALITY, ROOT, box, surface

LIGHT = (0.6, 0.0, 0.8)
#: Rows of J⁻¹: as it is, sheared and flat, mirrored.
CHARTS = {
    "straight": np.eye(3),
    "sheared": np.array([[1.0, 0.4, 0.0], [0.0, 2.0, 0.3], [0.2, 0.0, 5.0]]),
    "mirrored": np.array([[-1.0, 0.0, 0.2], [0.0, 1.0, 0.0], [0.0, 0.3, 1.5]]),
}


def here_of(rows: np.ndarray) -> IntervalFrame:
    frame = no_frame()
    frame.a, frame.b, frame.c = (mi.Vector3f(*map(float, row)) for row in rows)
    return frame


@pytest.mark.parametrize("name", CHARTS)
def test_directions_have_the_density_that_they_say(name) -> None:
    """Mitsuba's own test of samplers."""
    frame = here_of(CHARTS[name])
    chi2 = mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(),
        sample_func=lambda xi: scatter.draw(frame, xi)[0],
        pdf_func=lambda d: scatter.density(frame, d),
        sample_dim=2,
        sample_count=400_000,
        res=64,
        ires=8,
    )
    assert chi2.run(), chi2.messages


@pytest.mark.parametrize("name", CHARTS)
def test_a_drawn_direction_is_its_canonical_ones(name) -> None:
    frame, rng = here_of(CHARTS[name]), np.random.default_rng(0)
    d, local, p = scatter.draw(frame, mi.Point2f(rng.random((2, 1000)).astype(np.float32)))
    np.testing.assert_allclose(np.array(dr.normalize(canonical(frame, d))), np.array(local), atol=1e-5)
    assert (np.array(p) > 0).all() and np.array(local)[2].min() > -scatter.FADE - 1e-6


def test_a_shell_is_left_through_its_top_but_no_farther_off_than_at_a_quarter() -> None:
    """A flat shell of thickness 0.2, from h = 0.4: the way up is 0.12 over the cosine, or over 1/4 below that; 0 downward."""
    frame = here_of(np.diag([1.0, 1.0, 5.0]))
    for cosine, expected in ((1.0, 0.12), (0.5, 0.24), (0.25, 0.48), (0.05, 0.48), (1e-9, 0.48), (0.0, 0), (-0.5, 0)):
        d = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, cosine)
        np.testing.assert_allclose(np.array(scatter.exit_distance(frame, mi.Float(0.4), d, 10.0)), expected, rtol=1e-5)
    assert float(np.array(scatter.exit_distance(frame, mi.Float(0.4), mi.Vector3f(0, 0, 1), 0.1))[0]) == np.float32(0.1)


@pytest.mark.parametrize("spacing", [pytest.param("length", marks=pytest.mark.slow), "density"])
def test_collisions_are_drawn_by_their_weights(spacing: str) -> None:
    """Transmittance and light of the flat box by 512 drawn flights a ray, and by quadrature: z-tests of 64 rays."""
    mesh = box()
    shells = Shells([extrude(mesh, 1.0, 1.0)])
    media = Media(shells, [Medium(Material(read_bundle(ROOT / "src/mesoshell/assets/grass.npz")), (AGE,))])
    quality = QUALITY.with_changes(spacing=spacing)
    plan = plan_effects(Facts(shells=1, distant=1, coarsest=2.0, seen=False), quality, PATHS)
    context = RenderContext(shells, media, None, quality, plan)
    rng, count, draws = np.random.default_rng(0), 64, 512
    target = rng.uniform(0.2, 0.8, (3, count))
    d = rng.normal(size=(3, count)) - np.array([[0], [0], [2.0]])
    d = (d / np.linalg.norm(d, axis=0)).astype(np.float32).astype(np.float64)

    def ray(times: int) -> Ray:
        n = count * times
        o, along = (mi.Vector3d(np.repeat(x, times, axis=1)) for x in (target - 3 * d, d))
        far = dr.full(mi.Float64, 10.0, n)
        return Ray(
            o, along, dr.zeros(mi.Float64, n), far, dr.full(mi.Bool, True, n), dr.full(mi.Float, 1e-3, n), mi.Float(0)
        )

    rgb, through, _ = gather_light(context, surface(mesh), ray(1), [(mi.Vector3f(*LIGHT), mi.Color3f(1))])
    many = ray(draws)
    numbers = mi.Float(rng.random(count * draws).astype(np.float32))
    flight = fly(context, many, -dr.log(1 - numbers), dr.full(mi.Bool, True, count * draws))
    view = dr.normalize(canonical(flight.frame, -mi.Vector3f(many.d)))
    light = dr.normalize(canonical(flight.frame, mi.Vector3f(*LIGHT)))
    rho = dr.select(flight.collided, media.rho(flight.sample, media.decode(flight.sample)[1], view, [light])[0], 0)
    for drawn, expected in ((1 - np.array(flight.collided), np.array(through)), (np.array(rho)[1], np.array(rgb)[1])):
        rows = drawn.reshape(count, draws)
        often = expected > 0.1 * expected.max()  # elsewhere too few of the draws count for a deviation
        z = (rows.mean(axis=1) - expected)[often] / (rows.std(axis=1)[often] / draws**0.5)
        assert often.sum() >= 10 and np.abs(z).max() < 4.5
        whole = (rows.mean() - expected.mean()) / ((rows.var(axis=1) / draws).sum() ** 0.5 / count)
        assert abs(whole) < 4
    assert 0.05 < np.array(through).mean() < 0.9
