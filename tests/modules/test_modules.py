"""Flax's modules are the pure functions: one tree of parameters, the same numbers, the same arrays on disk."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax.errors import ScopeParamShapeError

import mesoshell as ms
from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.surface import read_surface, write_surface
from mesoshell.neutex import field as captured
from mesoshell.neutex.field import FieldConfig, init_field
from mesoshell.neutex.store import NeuTexModel, read_neutex, write_neutex
from mesoshell.shell.generator.discriminator import DiscriminatorConfig, discriminate, init_discriminator
from mesoshell.shell.generator.generator import (
    draw_phases,
    init_averages,
    init_generator,
    map_latent,
    synthesise,
    synthesise_height,
)
from mesoshell.shell.generator.model import generator_arrays
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.generator.texture_critic import CriticConfig, criticise, init_critic
from mesoshell.shell.generator.vision_aided import init_vision_aided, judge, perceive
from mesoshell.shell.material import decoder as decoding
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.shell.material.loader import decoder_of
from mesoshell.surface_material.network import (
    SurfaceConfig,
    SurfaceQuery,
    blur_textures,
    eval_opacity,
    init_surface,
    reflectance,
)
from tests.helpers import growing, wearing
from tests.helpers.octahedron import PHOTO
from tests.helpers.same_trees import FIELD, same

KEY = jax.random.key(4)
GENERATOR = GeneratorConfig(16, "T", 64, 4, channels=4, layers=4, z=4, w=4, betas=1, height_rows=8, height_width=4)
JUDGE = DiscriminatorConfig(8, 32, 4, labels=3, embedding=4)
CRITIC = CriticConfig(3, width=4, betas=1)
SURFACE = SurfaceConfig(8, 3, (8,))


class Case(NamedTuple):
    """draw: of the tree, from a key; others: collections beside `params`; pure: of tree, inputs."""

    module: Any
    draw: Callable[[Any], Any]
    inputs: tuple[Any, ...]
    pure: Callable[..., Any]
    others: dict[str, Any] = {}  # noqa: RUF012  (a NamedTuple's default)


def normal(seed: int, *shape: int) -> jax.Array:
    return jax.random.normal(jax.random.key(seed), shape, jnp.float32)


def unit(seed: int, *shape: int) -> jax.Array:
    x = normal(seed, *shape, 3)
    return x / jnp.linalg.norm(x, axis=-1, keepdims=True)


def _generated(tree: Any, z: Any, beta: Any, phases: Any, tile: Any) -> Any:
    w = map_latent(tree, z, beta)
    texture = synthesise(GENERATOR, tree, init_averages(GENERATOR), w, phases, tile, (16, 8))
    return texture, synthesise_height(GENERATOR, tree, w)


def _decoded(tree: Any, x: Any, w: Any, light: Any) -> Any:
    sigma, features = decoding.trunk(tree, x)
    return sigma, decoding.head(tree, decoding.toward_viewer(tree, features, w), light)


def _answered(tree: Any, place: SurfaceQuery, light: Any, blur: Any) -> Any:
    table = blur_textures(tree, blur)
    found = eval_opacity(SURFACE, table, place)
    return found, reflectance(SURFACE, table, place, found, light)


def _captured(config: FieldConfig, tree: Any, y: Any, d: Any) -> Any:
    sigma, features = captured.density(config, tree, y)
    if config.colour == "reflectance":
        made = captured.lobes(config, tree, captured.to_texture(tree, y))
        return sigma, (captured.normal(tree, y, features), made)
    return sigma, captured.radiance(config, tree, y, d, features)


def _case_of_field(colour: Any) -> Case:
    config = FieldConfig(**{**FIELD.__dict__, "colour": colour})
    inputs = 0.3 * normal(0, 3), unit(1)
    return Case(
        ms.modules.CapturedField(config), lambda key: init_field(config, key), inputs, lambda *x: _captured(config, *x)
    )


def case(name: str) -> Case:
    """A network by name, with inputs: made when its test runs."""
    if name == "generator":
        inputs = normal(0, 2, 4), jnp.full((2, 1), 0.3), draw_phases(GENERATOR, KEY, 2), jnp.array([3, 1])
        others = {"averages": init_averages(GENERATOR)}
        module = ms.modules.Generator(GENERATOR, (16, 8))
        return Case(module, lambda key: init_generator(GENERATOR, key), inputs, _generated, others)
    if name == "discriminator":
        inputs = normal(0, 4, 8, 8, 3), normal(1, 4, 3)
        return Case(ms.modules.Discriminator(JUDGE), lambda key: init_discriminator(JUDGE, key), inputs, discriminate)
    if name == "vision-aided":
        inputs, config = (normal(0, 4, 8, 8, 3), normal(1, 4, 3)), replace(JUDGE, kind="vision-aided")
        module = ms.modules.Discriminator(config)
        return Case(
            module, lambda key: init_vision_aided(config, key), inputs, lambda t, y, c: judge(t, perceive(y), c)
        )
    if name == "critic":
        inputs = normal(0, 2, 42, 42, 3), jnp.full((2, 1), 0.3)
        return Case(ms.modules.TextureCritic(CRITIC), lambda key: init_critic(CRITIC, key), inputs, criticise)
    if name == "decoder":
        inputs = normal(0, 5, 4), unit(1, 5), unit(2, 5)
        module = ms.modules.Decoder(4, ((8, 8), (8,)))
        return Case(module, lambda key: init_decoder(key, 4, (8, 8), (8,)), inputs, _decoded)
    if name == "surface":
        place = SurfaceQuery(jnp.array([0.3, 0.8]), jnp.float32(0.1), unit(1), jnp.float32(0.4))
        inputs = place, unit(2), jnp.float32(0.5)
        return Case(ms.modules.SurfaceMaterial(SURFACE), lambda key: init_surface(SURFACE, key), inputs, _answered)
    return _case_of_field(name)


NAMES = [
    "generator",
    "discriminator",
    "vision-aided",
    "critic",
    "decoder",
    "surface",
    "texture",
    "volume",
    "reflectance",
]
#: A captured object's field is one module whatever gives it its colours, and the critics are alike.
EACH = [pytest.param(x, marks=pytest.mark.slow if x in ("critic", "volume", "reflectance") else ()) for x in NAMES]


@pytest.mark.parametrize("name", EACH)
def test_a_module_is_its_pure_functions(name: str) -> None:
    module, draw, inputs, pure, others = case(name)
    tree = draw(KEY)
    variables = module.init(KEY, method="tree")
    same(variables["params"], dict(tree._asdict()))
    same(module.bind(variables).tree(), tree)
    same(jax.jit(module.apply)({"params": tree} | others, *inputs), jax.jit(pure)(tree, *inputs))


@pytest.mark.parametrize("name", EACH)
def test_init_with_inputs_declares_everything_that_apply_needs(name: str) -> None:
    module, draw, inputs, _, others = case(name)
    shapes = jax.eval_shape(module.init, KEY, *inputs)
    assert shapes.keys() == {"params"} | others.keys()
    assert jax.tree.structure(shapes["params"]) == jax.tree.structure(dict(draw(KEY)._asdict()))
    jax.eval_shape(module.apply, shapes, *inputs)


@pytest.mark.parametrize("name", NAMES)
def test_a_table_shows_each_array_and_counts_them(name: str) -> None:
    module, draw, inputs, _, others = case(name)
    table = module.tabulate(KEY, *inputs, console_kwargs={"width": 200, "force_terminal": False})
    leaves = jax.tree.leaves((draw(KEY), others))
    assert f"{sum(x.size for x in jax.tree.leaves(draw(KEY))):,}" in table
    assert table.count("float32[") >= len(leaves)
    for x in leaves:
        assert f"float32[{','.join(map(str, x.shape))}]" in table


def test_modules_are_differentiated_and_mapped() -> None:
    module, draw, inputs, pure, _ = case("decoder")
    tree = draw(KEY)
    by_module = jax.jit(jax.grad(lambda tree: jnp.sum(module.apply({"params": tree}, *inputs)[1])))(tree)
    same(by_module, jax.jit(jax.grad(lambda tree: jnp.sum(pure(tree, *inputs)[1])))(tree))
    each = jax.jit(jax.vmap(lambda *row: module.apply({"params": tree}, *row)))(*inputs)
    same(each, jax.jit(jax.vmap(lambda *row: pure(tree, *row)))(*inputs))


def test_parameters_of_another_shape_are_refused() -> None:
    module, _, inputs, _, _ = case("decoder")
    with pytest.raises(ScopeParamShapeError, match=r"trunk.*\(8, 8\).*\(8, 9\)"):
        module.apply({"params": init_decoder(KEY, 4, (8, 9), (8,))}, *inputs)


def test_a_submodule_draws_from_a_key_of_its_own() -> None:
    class Two(nn.Module):
        @nn.compact
        def __call__(self, *inputs: Any) -> Any:
            first, second = (ms.modules.Decoder(4, ((8,), (8,)), name=name) for name in ("first", "second"))
            return first(*inputs)[0] + second(*inputs)[0]

    inputs = case("decoder").inputs
    variables: Any = Two().init(KEY, *inputs)
    kernels = [variables["params"][name]["rho"].kernel for name in ("first", "second")]
    assert (kernels[0] != kernels[1]).all()


def test_what_a_shell_s_file_holds(tmp_path: Path) -> None:
    path = tmp_path / "shell.npz"
    write_bundle(path, growing.bundle())
    stored = read_bundle(path)
    found = ms.modules.networks_of(stored)
    assert found.keys() == {"decoder", "generator"}
    same(generator_arrays(found["generator"].tree(), found["generator"].averages()), _of_generator(stored.arrays))
    decoder = decoder_of(stored.arrays)
    inputs = normal(0, 5, len(decoder.trunk[0].kernel)), unit(1, 5), unit(2, 5)
    same(found["decoder"](*inputs), _decoded(decoder, *inputs))
    module, variables = found["decoder"].unbind()
    same(module.bind(variables).tree(), decoder)


def _of_generator(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: x for name, x in arrays.items() if name.startswith("generator/")}


def test_what_a_surface_material_s_file_holds(tmp_path: Path) -> None:
    path = tmp_path / "surface.npz"
    write_surface(path, wearing.bundle())
    surface = ms.modules.networks_of(read_surface(path))["surface"]
    u, w, light = np.array([[0.3, 0.8]]), np.array([[0.0, 0.6, 0.8]]), np.array([[0.6, 0.0, 0.8]])
    alpha, _, rho = wearing.answers(wearing.bundle(), u, np.array([0.05]), w, np.array([0.5]), light)
    place = SurfaceQuery(*(jnp.asarray(x, jnp.float32) for x in (u[0], 0.05, w[0], 0.0)))
    found, answer = surface(place, jnp.asarray(light[0], jnp.float32), jnp.float32(1e-3))
    np.testing.assert_allclose(found.alpha, alpha[0], rtol=1e-4)
    np.testing.assert_allclose(answer, rho[0], rtol=1e-3)


def test_what_a_captured_object_s_file_holds(tmp_path: Path) -> None:
    tree = init_field(FIELD, KEY)
    write_neutex(tmp_path / "object.npz", NeuTexModel(FIELD, tree, np.zeros(3), 1.0, (PHOTO,), (), {}))
    field = ms.modules.networks_of(read_neutex(tmp_path / "object.npz"))["field"]
    same(field.tree(), tree)
    inputs = case("texture").inputs
    same(field(*inputs), _captured(FIELD, tree, *inputs))
