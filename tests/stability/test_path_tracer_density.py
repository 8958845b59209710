"""Hard cases 10, 11 and 12 in the path tracer: extinction from 0 to infinity, thousands of samples, softplus at ±1e4.

Oracle: mpmath on the same float32 numbers.
"""

from tests.helpers.stability import dr_march  # noqa: F401  isort: skip  (it makes Mitsuba ready)

from dataclasses import replace
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import mpmath
import numpy as np
import pytest

from mesoshell.geometry.mesh import check_mesh
from mesoshell.io.bundle import Bundle
from mesoshell.pathtracer.direct import gather_light, opacity
from mesoshell.pathtracer.free_flight import fly
from mesoshell.pathtracer.levels import softplus
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.render_context import RenderContext
from mesoshell.pathtracer.samples import Ray, nothing
from mesoshell.pathtracer.shells import Shells
from mesoshell.pathtracer.surface_material import _sigmoid
from mesoshell.render.effects import PATHS, plan_effects
from mesoshell.render.facts import Facts
from mesoshell.render.quality import PRESETS
from mesoshell.shell.geometry.extrude import extrude
from tests.helpers.stability.extremes import (
    LENGTHS,
    POINTS,
    SIGMAS,
    STEPS,
    depths,
    true_opacity,
    true_softplus,
    true_sums,
)

mpmath.mp.dps = 50


class Layers:
    """A medium of STEPS layers, one a sample of a ray straight down: σ of each, top first."""

    def __init__(self, sigma: np.ndarray):
        self.table = mi.Float(sigma.astype(np.float32))

    def bound(self, sample, taps) -> mi.Float:
        return mi.Float(1)

    def sigma(self, sample, taps, baked=False) -> mi.Float:
        return dr.gather(mi.Float, self.table, mi.UInt32(dr.clip((1 - sample.xi.z) * STEPS, 0, STEPS - 1)))

    def decode(self, sample, taps) -> tuple[mi.Float, list]:
        return self.sigma(sample, taps), []

    def rho(self, sample, features, w, lights) -> list:
        return []


def through(sigma: np.ndarray) -> tuple[float, float]:
    """Optical depth of a flight, and the transmittance of a sum over the same samples, through the unit box."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    shells = Shells([extrude(check_mesh(corners, faces, corners[faces][..., :2], "box"), 1.0, 1.0)])
    quality = PRESETS["normal"].with_changes(samples=STEPS, spacing="length", early_stop=0.0, skip=0.0)
    plan = plan_effects(Facts(shells=1, distant=1, convex=True), quality, PATHS)
    context = RenderContext(shells, Layers(sigma), None, quality, plan)
    zero, far, yes = dr.zeros(mi.Float64, 1), dr.full(mi.Float64, 1.5, 1), dr.full(mi.Bool, True, 1)
    spread = dr.zeros(mi.Float, 1)
    ray = Ray(mi.Vector3d(0.7, 0.2, 2.0), mi.Vector3d(0, 0, -1), zero, far + 10, yes, spread, mi.Float(spread))
    flight = fly(context, ray, dr.inf, dr.full(mi.Bool, True, 1))
    _, left, queries = gather_light(context, mi.load_dict({"type": "scene"}), ray)
    assert int(queries[0]) == STEPS
    return float(flight.depth[0]), float(left[0])


@pytest.mark.parametrize("kind", ["1e-6", "1", "60", "equal"])
def test_log_transmittance_of_thousands_of_samples(kind: str) -> None:
    sigma = np.full(STEPS, 0.1, np.float32) * 7 if kind == "equal" else depths(float(kind), 1) * np.float32(STEPS)
    tau = sigma * np.float32(1 / STEPS)
    total = true_sums(tau)[-1]
    depth, left = through(sigma)
    np.testing.assert_allclose(depth, total, rtol=2e-7)
    np.testing.assert_allclose(np.log(left), -total, rtol=1e-6, atol=1.2e-7)  # T near 1 is rounded to ε


@pytest.mark.parametrize("sigma", SIGMAS)
def test_opacity(sigma: float) -> None:
    t = np.array(LENGTHS, np.float32)
    tau = mi.Float(dr.minimum(mi.Float(np.full(len(t), sigma, np.float32)), 1e20) * mi.Float(t))
    expected = [float(true_opacity(float(np.float32(sigma)), float(x))[0]) for x in t]
    np.testing.assert_allclose(np.array(opacity(tau)), expected, rtol=1e-6, atol=1e-19)


def test_opacity_of_every_size() -> None:
    tau = np.concatenate([[0], 10.0 ** np.linspace(-37, 38, 4000)]).astype(np.float32)
    expected = [float(true_opacity(float(x), 1.0)[0]) for x in tau]
    np.testing.assert_allclose(np.array(opacity(mi.Float(tau))), expected, rtol=5e-7, atol=1e-37)


@pytest.mark.parametrize("sigma", [0.0, 1e-30, 1e-12, 1e7, np.inf])
def test_flights_through_any_extinction(sigma: float) -> None:
    depth, left = through(np.full(STEPS, sigma))
    assert 0 <= depth < np.inf and 0 <= left <= 1
    expected = 1e20 if np.isinf(sigma) else float(np.float32(sigma))
    np.testing.assert_allclose(depth, expected, rtol=1e-6)
    np.testing.assert_allclose(left, np.exp(-expected), rtol=1e-6)


def test_softplus() -> None:
    x = np.concatenate([POINTS, np.linspace(-30, 30, 1201)]).astype(np.float32)
    np.testing.assert_allclose(np.array(softplus(mi.Float(x))), true_softplus(x), rtol=1e-6, atol=1e-37)


def test_a_sigmoid_has_no_overflow() -> None:
    expected = [float(1 / (1 + mpmath.exp(-mpmath.mpf(float(v))))) for v in POINTS]
    np.testing.assert_allclose(np.array(_sigmoid(mi.Float(POINTS))), expected, rtol=1e-6, atol=1e-37)


def saying(bundle: Bundle, sigma: float, rho: float) -> Material:
    """A material whose outputs are these numbers before their softplus, whatever it sees."""
    arrays = {k: np.zeros_like(v) if k.startswith("decoder/") else v for k, v in bundle.arrays.items()}
    arrays |= {"sigma_scale": np.array(30, np.float32), "decoder/sigma/bias": np.full(1, sigma, np.float32)}
    return Material(replace(bundle, arrays=arrays | {"decoder/rho/bias": np.full(3, rho, np.float32)}))


@pytest.mark.parametrize("raw", [float(x) for x in POINTS])
def test_extinction_and_transport_of_a_network_that_says_anything(tiny_bundle: Bundle, raw: float) -> None:
    material = saying(tiny_bundle, raw, raw)
    sample = nothing()
    sample.xi = mi.Vector3f(0.3, 0.2, 0.5)
    seen = material.inputs(sample, [mi.Float(0.5)])
    sigma, features = material.density_of(seen)
    up = mi.Vector3f(0, 0, 1)
    rho = material.transport(list(features), up, up)
    shifted = SimpleNamespace(sigma=np.array([np.float32(raw) - np.float32(3)]), rho=np.float32(raw) - np.float32(2))
    np.testing.assert_allclose(np.array(sigma), 30 * true_softplus(shifted.sigma), rtol=1e-6, atol=1e-36)
    expected = true_softplus(np.array([shifted.rho]))
    np.testing.assert_allclose(np.array(rho)[:, 0], np.repeat(expected, 3), rtol=1e-6, atol=1e-37)


@pytest.mark.parametrize("w", [(0, 0, -1.0), (0, 0, 0), (1.0, 0, 0), (1.0, 0, -1e-30)])
def test_directions_straight_down_or_zero(tiny_bundle: Bundle, w: tuple[float, float, float]) -> None:
    material = Material(tiny_bundle)
    sample = nothing()
    sample.xi = mi.Vector3f(0.3, 0.2, 0.5)
    seen = material.inputs(sample, [mi.Float(0.5)])
    _, features = material.density_of(seen)
    assert np.isfinite(np.array(material.transport(list(features), mi.Vector3f(*w), mi.Vector3f(*w)))).all()
