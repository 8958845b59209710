"""Pictures of materials from renders' cameras, and fields from above: against the field itself, point by point."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.bundle import Parameter, read_bundle
from mesoshell.io.dataset_images import load_images
from mesoshell.io.material import find
from mesoshell.measure import above, fields
from mesoshell.measure.posed import pose_material
from mesoshell.render.composite import weights
from mesoshell.shell.generator.texture_synthesis import TextureRequest
from mesoshell.shell.material.field import Point, neural_field
from mesoshell.shell.material.loader import load_device_material
from tests.helpers import fog, growing

#: Programs that its tests share.
pytestmark = pytest.mark.xdist_group("posed")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return fog.write(tmp_path_factory.mktemp("posed") / "fog", fog.CAMERAS, size=6)


@pytest.fixture(scope="module")
def flat(tiny_bundle):
    """The same all over the patch, so that no shift changes it."""
    arrays = {k: a[:1, :1] * np.ones_like(a) if k.startswith("features") else a for k, a in tiny_bundle.arrays.items()}
    age = replace(tiny_bundle.parameters[0], name="age", range=(0.0, 20.0))
    return replace(tiny_bundle, arrays=arrays, parameters=(age,))


def test_a_fitted_patch_is_seen_at_the_parameters_of_the_renders(flat, data) -> None:
    """The same with another default; another where the renders say nothing of it; black where a ray misses the box."""
    samples = list(data.samples)
    found = pose_material(flat, "flat", data).pictures(samples, 0)
    other = replace(flat, parameters=(replace(flat.parameters[0], default=15.0),))
    assert found.shape == (4, 6, 6, 4) and np.isfinite(found).all()
    np.testing.assert_array_equal(found, pose_material(other, "flat", data).pictures(samples, 0))
    unknown = [replace(p, name="dryness") for p in (*flat.parameters, *other.parameters)]
    a, b = (pose_material(replace(flat, parameters=(p,)), "flat", data).pictures(samples, 0) for p in unknown)
    assert np.abs(a - b).max() > 1e-3 and np.abs(a - found).max() > 1e-3
    np.testing.assert_array_equal(found[..., 3] > 0, load_images(data)[..., 3] > 0)


def test_a_generator_is_seen_with_its_correction(data) -> None:
    bundle = growing.bundle()
    zero = np.zeros((1 + int(np.log2(growing.TEXELS)), 2, bundle.channels), np.float32)
    plain, same, other = (
        pose_material(replace(bundle, arrays=bundle.arrays | more), "grown", data).pictures(list(data.samples[:2]), 0)
        for more in ({}, {"correction": zero}, {"correction": zero + 1})
    )
    np.testing.assert_allclose(same, plain, atol=1e-5)
    assert np.abs(other - plain).max() > 1e-3


def test_a_patch_that_is_shifted_is_another_picture_each_seed(tiny_bundle, flat, data) -> None:
    one = list(data.samples[:1])
    rough, even = pose_material(tiny_bundle, "tiny", data), pose_material(flat, "flat", data)
    apart, noise = (np.abs(p.pictures(one, 0) - p.pictures(one, 1)).max() for p in (rough, even))
    assert apart > 5 * noise
    np.testing.assert_array_equal(rough.pictures(one, 3), rough.pictures(one, 3))


def test_a_generator_makes_another_texture_for_each(data) -> None:
    bundle = growing.bundle()
    twice = pose_material(bundle, "made", data).pictures([data.samples[0]] * 2, 0)
    assert twice.shape == (2, 6, 6, 4) and np.abs(twice[0] - twice[1]).max() > 0
    edges = replace(bundle, generator=None, wraps=False)
    with pytest.raises(InputError, match="holds a texture with edges"):
        pose_material(edges, "cut", data)


@pytest.fixture(scope="module")
def column(tiny_bundle):
    """σ and ρ of one column of a field, layer by layer from the base, by the field itself."""
    found, light = load_device_material(tiny_bundle), jnp.array([0.6, 0.0, 0.8])
    field = neural_field(found.material, found.layout)
    layers, alpha = 5, np.array([0.4], np.float32)

    def at(v: float, u: float):
        rows = []
        for k in range(layers):
            radius, deviation = jnp.asarray(1 / (12**0.5 * 6)), jnp.asarray(1 / (12**0.5 * layers))
            xi = jnp.array([u, v, (k + 0.5) / layers])
            sigma, hidden = field.density(Point(xi, radius, deviation, jnp.asarray(alpha)))
            rows.append((sigma, field.transport(hidden, jnp.array([0.0, 0.0, 1.0]), light)))
        return jnp.stack([s for s, _ in rows]), jnp.stack([r for _, r in rows])

    return found, alpha, layers, jax.jit(at)


def test_a_field_from_above_is_the_field(column) -> None:
    found, alpha, layers, at = column
    opacity = above.opacities(found, alpha, (2, 6), layers)
    picture = above.picture(found, alpha, (2, 6), (0.6, 0.0, 0.8), layers)
    assert opacity.shape == (layers, 12, 12) and picture.shape == (12, 12, 3)
    for row, pixel in ((0, 0), (7, 2), (11, 5)):
        sigma, rho = at((row + 0.5) / 6, (pixel + 0.5) / 6)
        np.testing.assert_allclose(opacity[:, row, pixel], -np.expm1(-np.asarray(sigma) / layers), rtol=1e-4)
        share = weights(sigma[::-1] / layers)[0]
        radiance = np.asarray(40 * share @ rho[::-1])
        np.testing.assert_allclose(picture[row, pixel], radiance / (1 + radiance), rtol=1e-3)


def test_a_patch_that_repeats_is_found_to_repeat_and_to_be_its_own_copy(tiny_bundle, monkeypatch) -> None:
    monkeypatch.setattr(fields, "FIELD", (4, 6))
    monkeypatch.setattr(fields, "PATCH", 8)
    assert fields.repeat(fields.seen_from_above(tiny_bundle, "tiny")) == pytest.approx(1, abs=1e-4)
    mine = fields.patches(tiny_bundle, "tiny")
    shifted = np.roll(mine, (3, 5), (2, 3))
    (found,) = fields.nearest_exemplars(shifted, mine)
    assert found.distance == pytest.approx(0, abs=1e-6) and found.shift == (5, 3)


def test_combing_follows_a_pile_that_is_combed(monkeypatch) -> None:
    """A pile that leans as it is asked to is off by little; one that leans a quarter turn aside by a quarter turn."""
    base = growing.bundle()
    lean = Parameter("lean_angle", "beta", (0.0, 2 * np.pi), 0.0, "rad", "combed")
    bundle = replace(base, parameters=(base.parameters[0], lean))
    assert fields.combs(bundle) and not fields.combs(base)
    pile: dict[str, Any] = {"aside": 0.0}
    rng = np.random.default_rng(0)
    waves = [(*rng.normal(size=2) * 9, rng.uniform(0, 6.28)) for _ in range(40)]

    def grown(bundle, name, side, wanted):
        pile["asked"] = wanted.fields["lean_angle"]
        return None, None

    def leaning(found, alpha, field, layers):
        """Waves that move with height as they are asked to, and aside."""
        c = (np.arange(field[0] * field[1]) + 0.5) / field[1]
        u, v = np.meshgrid(c, c)
        angle = 2 * np.pi * pile["asked"](np.stack([u, v], axis=-1)) + pile["aside"]
        h = (np.arange(layers)[:, None, None] + 0.5) / layers
        at_u, at_v = u - 0.5 * h * np.cos(angle), v - 0.5 * h * np.sin(angle)
        return np.asarray(sum(np.cos(a * at_u + b * at_v + p) for a, b, p in waves))

    def seen(found, alpha, field, light, layers):
        """Their mean along the height, of which 12 places are enough, has strokes along the lean."""
        return np.repeat(leaning(found, alpha, field, 12).mean(axis=0)[..., None], 3, axis=2)

    monkeypatch.setattr(fields, "_grown", grown)
    monkeypatch.setattr(above, "opacities", leaning)
    monkeypatch.setattr(above, "picture", seen)
    off = fields.combing_error(bundle, "combed")
    assert off.lean < 15 and off.strokes < 25
    pile["aside"] = np.pi / 2
    off = fields.combing_error(bundle, "combed")
    assert off.lean == pytest.approx(90, abs=15) and off.strokes > 65


@pytest.mark.slow
def test_the_bundled_carpet_is_combed_by_a_field() -> None:
    assert fields.combing_error(read_bundle(find("carpet")), "carpet").lean < 16  # degrees; 20 are asked, 90 are chance


@pytest.mark.slow
def test_the_bundled_fur_is_as_long_as_asked() -> None:
    """Of what is met first from above, the height that a twentieth exceeds: hairs lean, so less than their length."""
    fur, layers = read_bundle(find("fur")), 32

    def height(length: float) -> float:
        request = TextureRequest(fields={"length": lambda at: np.full(at.shape[:-1], length)})
        found, alpha = fields._grown(fur, "fur", 2, request)
        down = above.opacities(found, alpha, (2, 64), layers)[::-1]
        met = down * np.cumprod(1 - down, axis=0) / np.maximum(1 - down, 1e-6)
        return float(np.quantile(np.tensordot((layers - np.arange(layers) - 0.5) / layers, met, 1), 0.95))

    lengths = [0.25, 0.6, 0.95]
    heights = [height((length - 0.25) / 0.7) for length in lengths]
    assert [h / length for h, length in zip(heights, lengths, strict=True)] == pytest.approx([0.75] * 3, abs=0.15)
