"""Hard case 19: what a decoder loses in 16 bits is stated, is true, and is small in a picture.

Oracles: the decoder's own code in float64 on the same float32 numbers; pictures compared by FLIP after tone mapping.
"""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mesoshell
from mesoshell.io.bundle import Bundle, Parameter, read_bundle, write_bundle
from mesoshell.measure.flip import flip
from mesoshell.nets.mlp import Dense
from mesoshell.render.camera import look_at
from mesoshell.shell.generator.discriminator import DiscriminatorConfig
from mesoshell.shell.generator.generator import init_averages, init_generator, synthesise, synthesise_height
from mesoshell.shell.generator.model import generator_model, grown
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.material.decoder import Decoder, head, init_decoder, toward_viewer, trunk
from mesoshell.shell.material.field import Layout, Material, Point, inputs
from mesoshell.shell.material.loader import load_device_material
from mesoshell.shell.material.precision import SHORT, STEP, decode, decoder_error
from mesoshell.shell.render.renderer import render
from mesoshell.train.export import generator_bundle
from mesoshell.train.gan.state import GanConfig, Learner, sized_for
from mesoshell.train.patch_renderer import PictureConfig, along, material_of, pixel_rays
from mesoshell.typing import Array
from tests.helpers import scenes

DOUBLE, SINGLE, HALF, BRAIN = np.dtype(np.float64), np.dtype(np.float32), SHORT["float16"], SHORT["bfloat16"]
VIEW = PictureConfig(size=48, samples=32, fov=0.5)
LIGHT, STRENGTH = np.array([0.48, -0.36, 0.8], np.float32), 30
PARAMETERS = (
    Parameter("age", "alpha", (0.0, 10.0), 2.0, "days", "how dry"),
    Parameter("length", "beta", (1.0, 3.0), 2.0, "cm", "length of a blade"),
)
#: Largest mean FLIP against the float32 picture; twice what was measured.
BOUNDS = {BRAIN: 0.02, HALF: 0.005, DOUBLE: 1e-5}


@pytest.fixture(scope="module")
def grass() -> Bundle:
    return read_bundle(Path(mesoshell.__file__).parent / "assets/grass.npz")


class Rays:
    """What the decoder is asked for a picture of the unit box: x, ω, ω′ of all samples, and their lengths, in float32."""

    def __init__(self, bundle: Bundle):
        made = load_device_material(bundle)
        pose = jnp.asarray(look_at((0.2, -1.4, 2.2), (0.5, 0.5, 0.4), (0.0, 0.0, 1.0)), jnp.float32)

        @jax.jit
        def asked(pose: Array) -> tuple[Array, Array, Array]:
            o, d = pixel_rays(VIEW, pose)
            middle, radius = jnp.full(VIEW.samples, 0.5), jnp.asarray(0.5 / VIEW.size)
            point, length = jax.vmap(lambda d: along(VIEW, o, d, radius, middle))(d)
            point = point._replace(alpha=jnp.full((*point.radius.shape, len(made.names)), 0.3))
            flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), point)
            return jax.vmap(lambda p: inputs(made.material, made.layout, p))(flat), length, d

        x, length, d = (np.asarray(v) for v in asked(pose))
        self.decoder, self.x, self.length = made.material.decoder, x, length
        self.w = np.repeat(-d, VIEW.samples, axis=0)
        self.w[:, 2] = np.maximum(self.w[:, 2], 0)
        self.w_light = np.broadcast_to(LIGHT, self.w.shape)

    def picture(self, kind: np.dtype) -> np.ndarray:
        """Tone-mapped; composited in float64 whatever the decoder's type."""
        sigma, rho = decode(self.decoder, self.x, self.w, self.w_light, kind)
        tau = sigma.reshape(len(self.length), -1).astype(np.float64) * self.length[:, None]
        before = np.cumsum(tau, axis=1) - tau
        share = np.exp(-before) * -np.expm1(-tau)
        radiance = STRENGTH * np.einsum("rn,rnc->rc", share, rho.reshape(*tau.shape, 3))
        return (radiance / (1 + radiance)).reshape(VIEW.size, VIEW.size, 3)


@pytest.fixture(scope="module")
def generated() -> Bundle:
    """A random generator's bundle, with one appearance and one geometry parameter."""
    config = sized_for(
        GanConfig(
            GeneratorConfig(16, "T", 64, 4, channels=4, layers=4, z=4, w=4, height_rows=8, height_width=4),
            DiscriminatorConfig(8, 64, 4, embedding=4),
            PictureConfig(8, 4, texels=16, height_rows=8, octaves=1),
            trunk=(16, 16),
            head=(16, 16),
        ),
        appearance=1,
        geometry=1,
    )
    encoded = config.generator.channels + 1 + 2 * config.picture.octaves + config.appearance
    k = jax.random.split(jax.random.key(3))
    decoder = init_decoder(k[1], encoded, config.trunk, config.head)
    learner = Learner(init_generator(config.generator, k[0]), decoder)
    averages = init_averages(config.generator)
    return generator_bundle(config, learner, averages, PARAMETERS, {"images": 0})


def material(bundle: Bundle) -> tuple[Material, Layout]:
    """A bundle's texture; of a generator, one patch of seed 0 in the middle of its geometry."""
    if bundle.generator is None:
        made = load_device_material(bundle)
        return made.material, made.layout
    maker, shape = generator_model(bundle, "bundle"), PictureConfig(texels=16, height_rows=8, octaves=1)
    w, phases = grown(maker, 0, np.array([0.5], np.float32))
    corner, size = jnp.zeros(2, jnp.int32), (16, 16)
    synthesised = jax.jit(lambda: synthesise(maker.config, maker.generator, maker.averages, w, phases, corner, size))
    feature = synthesised().feature[0]
    height = synthesise_height(maker.config, maker.generator, w)[0]
    return material_of(shape, feature, height, maker.decoder), shape.layout


def questions(bundle: Bundle, count: int = 16_000) -> tuple[Decoder, np.ndarray, np.ndarray]:
    """The bundle's decoder, and x and (ω, ω′) at random places of its texture."""
    random = np.random.default_rng(77)
    made, layout = material(bundle)
    alphas = sum(p.role == "alpha" for p in bundle.parameters)
    zero = jnp.zeros(count)
    xi, alpha = (jnp.asarray(random.uniform(size=(count, n)), jnp.float32) for n in (3, alphas))
    x = jax.jit(jax.vmap(lambda p: inputs(made, layout, p)))(Point(xi, zero, zero, alpha))
    toward = random.normal(size=(2, count, 3))
    toward[..., 2] = np.abs(toward[..., 2])
    return made.decoder, np.asarray(x), (toward / np.linalg.norm(toward, axis=-1, keepdims=True)).astype(np.float32)


def exactly(decoder: Decoder, x: np.ndarray, toward: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """σ and ρ by the decoder's own code in float64."""
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda v: jnp.asarray(np.asarray(v, np.float64)), (decoder, x, toward))
        sigma, found = trunk(wide[0], wide[1])
        return np.asarray(sigma), np.asarray(head(wide[0], toward_viewer(wide[0], found, wide[2][0]), wide[2][1]))


def shortly(decoder: Decoder, x: np.ndarray, toward: np.ndarray, kind: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """The same by matrix products of 16-bit numbers that are summed in float32."""

    def product(layer: Dense, x: Array) -> Array:
        short = x.astype(kind), layer.kernel.astype(kind)
        y = jnp.matmul(*short, preferred_element_type=jnp.float32)
        return y + layer.bias.astype(kind).astype(jnp.float32)[None]

    y = jnp.asarray(x)
    for layer in decoder.trunk:
        y = jax.nn.relu(product(layer, y))
    sigma = decoder.scale * jax.nn.softplus(product(decoder.sigma, y)[:, 0] - 3)
    y = jnp.concatenate([y, *map(jnp.asarray, toward)], axis=1)
    for layer in decoder.head:
        y = jax.nn.relu(product(layer, y))
    return np.asarray(sigma), np.asarray(jax.nn.softplus(product(decoder.rho, y) - 2))


def shown(sigma: np.ndarray, rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a = 1 - np.exp(-sigma.astype(np.float64) / 32)
    return a, a[:, None] * rho


@pytest.mark.parametrize("which", ["grass", "tiny_bundle", pytest.param("generated", marks=pytest.mark.slow)])
def test_the_statement_in_a_bundle_is_true(which: str, request: pytest.FixtureRequest, tmp_path: Path):
    """Root mean squares from other points of what the file holds, by other code; those of grass, most of it empty, vary
    by a tenth from draw to draw."""
    write_bundle(tmp_path / "a.npz", request.getfixturevalue(which))
    bundle = read_bundle(tmp_path / "a.npz")
    decoder, x, toward = questions(bundle)
    true = shown(*exactly(decoder, x, toward))
    for name, kind in SHORT.items():
        said = bundle.provenance["decoder_error"][name]
        found = shown(*shortly(decoder, x, toward, kind))
        for part, a, b in zip(("sigma", "rho"), found, true, strict=True):
            rms = np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2))
            assert said[part]["rms"] == pytest.approx(rms, rel=0.4), (name, part)
            assert 0.4 < said[part]["largest"] * b.max() / np.abs(a - b).max() < 2.5, (name, part)


def test_the_network_in_numpy_is_the_decoders(grass: Bundle):
    decoder, x, toward = questions(grass, 500)
    for found, true in zip(decode(decoder, x, toward[0], toward[1], DOUBLE), exactly(decoder, x, toward), strict=True):
        np.testing.assert_allclose(
            found, true, rtol=1e-6
        )  # the decoder makes directions unit vectors to 1e-16, not 1e-8
    for kind in SHORT.values():
        for found, true in zip(
            decode(decoder, x, toward[0], toward[1], kind), shortly(decoder, x, toward, kind), strict=True
        ):
            off = np.abs(found - true) / true.max()  # a sum in another order may round to a neighbour
            assert np.median(off) < 1e-6 and off.max() < 0.5 * float(jnp.finfo(kind).eps)


def test_a_picture_from_short_numbers(grass: Bundle):
    rays = Rays(grass)
    single = rays.picture(SINGLE)
    assert single.std() > 0.1
    off = {kind: flip(rays.picture(kind), single) for kind in BOUNDS}
    assert all(0 < off[kind] < bound for kind, bound in BOUNDS.items()), off
    assert off[DOUBLE] < off[HALF] / 50 and off[HALF] < off[BRAIN] / 2


def test_the_renderer_with_rounded_weights(tiny_bundle: Bundle):
    scene = scenes.slab(tiny_bundle)
    scene = replace(scene, camera=replace(scene.camera, width=48, height=48))

    def picture(kind: np.dtype) -> np.ndarray:
        made = scene.device_material.material
        rounded = jax.tree.map(lambda x: x.astype(kind).astype(jnp.float32), made.decoder)
        changed = replace(
            scene, device_material=replace(scene.device_material, material=made._replace(decoder=rounded))
        )
        radiance = render(changed, scenes.FULL, scenes.effects(changed, scenes.FULL))[0][..., :3]
        return radiance / (1 + radiance)

    single = picture(SINGLE)
    off = {kind: flip(picture(kind), single) for kind in SHORT.values()}
    assert single.std() > 0.1 and all(0 < off[kind] < BOUNDS[kind] for kind in off), off


def random_decoder() -> tuple[Decoder, np.ndarray, np.ndarray]:
    random = np.random.default_rng(5)
    decoder = init_decoder(jax.random.key(0), 8 + 3 + 1, (16, 16), (16,))
    feature, height = (random.normal(size=n).astype(np.float32) for n in ((4, 4, 8), (4, 8)))
    return decoder, feature, height


@pytest.mark.parametrize("where", ["weight", "bias", "activation", "feature"])
def test_a_decoder_that_overflows_half_precision_is_said_to_be_unusable(where: str):
    decoder, feature, height = random_decoder()
    first, second = decoder.trunk
    layers = {
        "weight": [first._replace(kernel=first.kernel.at[0, 0].set(1e5)), second],
        "bias": [first._replace(bias=first.bias.at[0].set(1e5)), second],
        "activation": [first._replace(kernel=300 * first.kernel), second._replace(kernel=300 * second.kernel)],
    }
    decoder = decoder._replace(trunk=layers.get(where, decoder.trunk))
    feature = feature * 1e3 if where == "activation" else feature * 1e5 if where == "feature" else feature
    said = decoder_error(decoder, feature, height, 1)
    assert said["float16"] is None
    if where == "feature":  # no texture in half precision holds it
        assert said["bfloat16"] is None
    else:
        assert all(np.isfinite(v) for part in said["bfloat16"].values() for v in part.values())


@pytest.mark.parametrize("raw", [1e4, -1e4])
def test_outputs_are_not_short(raw: float):
    """σ = 3·10⁵ is beyond half precision and 30·softplus(−10⁴) is 0: both are stated, and neither overflows."""
    decoder, feature, height = random_decoder()
    decoder = decoder._replace(sigma=decoder.sigma._replace(bias=jnp.full(1, raw)))
    for part in decoder_error(decoder, feature, height, 1).values():
        assert part["sigma"] == {"rms": 0.0, "largest": 0.0} and part["rho"]["rms"] < 0.02


def test_half_an_ulp_is_what_one_product_loses():
    """Known answer: σ's error where one weight is rounded and all else is exact."""
    decoder, feature, height = random_decoder()
    zero = jax.tree.map(jnp.zeros_like, decoder)._replace(scale=jnp.asarray(1.0))
    for name, kind in SHORT.items():
        half_ulp = float(jnp.finfo(kind).eps) / 4
        value = 1.5 + half_ulp  # rounds down by that
        said = decoder_error(zero._replace(sigma=zero.sigma._replace(bias=jnp.full(1, value))), feature, height, 1)
        sigma = np.log1p(np.exp(value - 3))
        slope = 1 / (1 + np.exp(3 - value)) / sigma * (STEP * sigma / np.expm1(STEP * sigma))
        for statistic in ("rms", "largest"):
            assert said[name]["sigma"][statistic] == pytest.approx(half_ulp * slope, rel=0.01)
