"""All that the package compiles, as programs of small shapes: named by the function that is given to `jax.jit`, and not run.

`compiled` reads the names from the sources, so that a program which is not here is missed by nobody.
"""

import ast
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import mesoshell
from mesoshell.io.bundle import Bundle
from mesoshell.io.exemplars import Exemplars
from mesoshell.measure import above, captured, equivariance
from mesoshell.nets import efficientnet, inception
from mesoshell.nets.encoding import HashConfig
from mesoshell.neutex import edit as paint
from mesoshell.neutex import mesh
from mesoshell.neutex import render as atlas_render
from mesoshell.neutex.field import FieldConfig, init_field
from mesoshell.shell.generator import bake, model
from mesoshell.shell.generator.discriminator import DiscriminatorConfig, init_discriminator
from mesoshell.shell.generator.generator import (
    draw_phases,
    init_averages,
    init_generator,
    map_latent,
)
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.geometry import batched_walk, march
from mesoshell.shell.geometry.march import Prisms, Ray, WalkState
from mesoshell.shell.geometry.sampling import Chart, Frame, Piece
from mesoshell.shell.material import baked_density, density_bounds, loader
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.shell.material.field import Layout, Point
from mesoshell.shell.render import kernels, lighting, spacing
from mesoshell.signal.fourier import shifted_phase
from mesoshell.stability import field as field_checks
from mesoshell.stability import surface as surface_checks
from mesoshell.stability import surface_material as surface_material_checks
from mesoshell.surface_material import network as surface_material
from mesoshell.surface_material import renderer as surface_renderer
from mesoshell.train import export, prefilter
from mesoshell.train.export import decoder_arrays
from mesoshell.train.fit import patch_rays
from mesoshell.train.fit import step as fit
from mesoshell.train.fit.patch_rays import FitData
from mesoshell.train.fit.slab_pixels import predict
from mesoshell.train.fit.state import FitConfig, material_of
from mesoshell.train.gan import snapshot
from mesoshell.train.gan import state as gan
from mesoshell.train.gan import step as gan_step
from mesoshell.train.gan.generate import ImageBatch
from mesoshell.train.nerf_tex import network as parametric
from mesoshell.train.nerf_tex import snapshot as parametric_snapshot
from mesoshell.train.neutex import step as atlas
from mesoshell.train.neutex.ray_batches import Rays
from mesoshell.train.patch_renderer import PictureConfig
from mesoshell.train.surface import shell_teacher
from mesoshell.train.surface import snapshot as surface_snapshot
from mesoshell.train.surface import step as surface
from mesoshell.train.textures import adversarial, natural_start, synthesis
from mesoshell.train.textures import snapshot as textures_snapshot
from mesoshell.train.textures import step as textures
from mesoshell.train.textures.exemplars import ExemplarBatch, scale_exemplars
from mesoshell.train.textures.state import TexturesConfig

SOURCES = Path(mesoshell.__file__).parent
ROWS = 4096
#: Whose products are no part of a result: `_matrix_rate` measures how fast they are, `run_cost` compiles the steps of `train`.
ELSEWHERE = {"measure.run_cost._matrix_rate", "measure.run_cost.run_cost"}
KEY = jax.random.key(0)


def f(*shape: int) -> Any:
    return jax.ShapeDtypeStruct(shape, jnp.float32)


def i(*shape: int) -> Any:
    return jax.ShapeDtypeStruct(shape, jnp.int32)


def u(*shape: int) -> Any:
    return jax.ShapeDtypeStruct(shape, jnp.uint32)


def b(*shape: int) -> Any:
    return jax.ShapeDtypeStruct(shape, jnp.bool_)


def compiled() -> set[str]:
    """Names of all functions that are given to jit or pmap, or give one: module.function, without the package's name."""
    return {name for path in SOURCES.rglob("*.py") for name in _compiling(ast.parse(path.read_text()), _module(path))}


def _module(path: Path) -> str:
    return ".".join(path.relative_to(SOURCES).with_suffix("").parts)


def _compiling(node: ast.AST, inside: str) -> Iterator[str]:
    for child in ast.iter_child_nodes(node):
        name = f"{inside}.{child.name}" if isinstance(child, ast.FunctionDef | ast.ClassDef) else inside
        if isinstance(child, ast.Attribute) and ast.unparse(child) in ("jax.jit", "jax.pmap"):
            yield name
        yield from _compiling(child, name)


def programs(bundle: Bundle) -> "Programs":
    """What traces them, in all the ways that matter, and functions that run as they are. bundle: a shell's."""
    makers = _of_shells(bundle) | _of_generators() | _of_surfaces() | _of_objects() | _of_training()
    makers |= _of_judges(bundle) | _of_corrections(bundle) | _of_beginnings()
    return makers


Programs = dict[str, list[Callable[[], Any]]]


def _jitted(function: Any, *arguments: Any) -> Callable[[], Any]:
    return lambda: function.trace(*arguments).jaxpr


def _plain(function: Callable, *arguments: Any) -> Callable[[], Any]:
    return lambda: jax.make_jaxpr(function)(*arguments)


def _of_shells(bundle: Bundle) -> Programs:
    device_material = loader.load_device_material(bundle)
    prisms, chart = Prisms(f(2, 18), i(2, 6)), Chart(f(2, 18), f(2, 6))
    rays = Ray(f(128, 3), f(128, 3), f(128, 3))
    place = WalkState(i(128), f(128), f(128), f(128, 2), f(128), i(128), b(128))
    pieces = Piece(i(ROWS), f(ROWS, 2), f(ROWS, 2, 2), f(ROWS, 2), f(ROWS, 3), f(ROWS, 3))
    at, samples = Frame(f(ROWS, 3), f(ROWS, 3), f(ROWS), f(ROWS, 3, 3)), kernels.Samples(i(ROWS), *(f(ROWS),) * 3)
    wraps = kernels.StaticConfig(device_material.layout, device_material.grid_shapes, True, 4, True, (0,))
    table = kernels.DeviceTables(chart, device_material.material, device_material.grid, f(1), (f(2, 2),), f(), f(), f())
    nodes = replace(device_material.layout, open=True, nodes=(3, 3))
    planes = Layout(
        device_material.layout.sizes,
        (),
        device_material.layout.texel_density,
        device_material.layout.octaves,
        True,
        cells=(2, 2),
    )
    ways = [wraps, *(replace(wraps, layout=layout) for layout in (nodes, planes))]
    corrected = device_material.material._replace(
        correction=f(len(device_material.layout.sizes), 2, device_material.material.height.rows.shape[1])
    )
    cell = (
        density_bounds._largest,
        device_material.layout,
        device_material.material,
        f(),
        (2, 4, 4),
        2,
        (f(2), f(2)),
        KEY,
    )
    baked = replace(wraps, baked=(2, 8, 8, 64))
    with_grid = table._replace(baked=jax.ShapeDtypeStruct((2 * 8 * 8 * 64,), jnp.float16))
    decoder = device_material.material.decoder
    found, placement = f(ROWS, decoder.trunk[-1].bias.shape[0]), shell_teacher.DevicePlacement(f(), f(2, 2), f(2))
    local = shell_teacher.LocalQuery(f(64, 2), f(64), f(64, 3), f(64, 3))
    return {
        "shell.geometry.march._steps": [_jitted(march._steps, prisms, rays, place)],
        "shell.geometry.batched_walk._walked": [_jitted(batched_walk._walked, prisms, rays, i(128), place)],
        "shell.geometry.batched_walk._advance": [_jitted(batched_walk._advance, prisms, rays, i(128), place, i())],
        "shell.render.kernels.frames": [_jitted(kernels.frames, chart, pieces, i())],
        "shell.render.kernels.depth_bounds": [
            _jitted(kernels.depth_bounds, p, table, pieces, at, samples, i()) for p in ways
        ],
        "shell.render.spacing.interval_segments": [_jitted(spacing.interval_segments, wraps, table, pieces, at, i())],
        "shell.render.spacing.depth_profile": [
            _jitted(spacing.depth_profile, p, device_material.grid, f(ROWS, 7), i(ROWS), f(ROWS), f(ROWS), i())
            for p in ways
        ],
        "shell.render.spacing.places": [_jitted(spacing.places, 4, f(ROWS, spacing.BINS), f(), i())],
        "shell.render.kernels.density": [
            *(_jitted(kernels.density, p, table, pieces, at, samples, i()) for p in ways),
            _jitted(kernels.density, wraps, table._replace(material=corrected), pieces, at, samples, i()),
        ],
        "shell.render.kernels.density_at": [_jitted(kernels.density_at, wraps, table, f(ROWS, 3), f(ROWS), i())],
        "shell.render.kernels.baked_depths": [
            _jitted(kernels.baked_depths, baked, with_grid, pieces, at, samples, i()),
        ],
        "shell.material.baked_density._lines": [
            _jitted(baked_density._lines, layout, (2, 8), device_material.material, f(1), i())
            for layout in (device_material.layout, nodes)
        ],
        "shell.render.kernels.transport": [
            _jitted(kernels.transport, table, at, pieces, found, i(ROWS), i(ROWS), f(ROWS, 2, 3), i())
        ],
        "shell.render.lighting._jacobians": [_jitted(lighting._jacobians, chart, i(ROWS), f(ROWS, 2), i())],
        "shell.material.density_bounds._largest": [_jitted(*cell)],
        "stability.surface._left": [_jitted(surface_checks._left, f(64, 3), f(64, 2, 3), f(64, 2, 3))],
        "stability.field._network_queries": [
            _jitted(
                field_checks._network_queries,
                device_material.layout,
                device_material.material,
                Point(f(64, 3), f(64), f(64), f(64, 1)),
                f(64, 3),
                f(64, 3),
            )
        ],
        "stability.field._bounds": [_jitted(field_checks._bounds, wraps, device_material.grid, f(64, 3))],
        "shell.material.density_bounds.new_points": [
            _jitted(
                density_bounds.new_points, device_material.layout, device_material.material, f(), 64, (f(2), f(2)), KEY
            )
        ],
        "train.surface.shell_teacher._taught": [
            _jitted(
                shell_teacher._taught,
                device_material.layout,
                shell_teacher.Teacher(device_material.material, f(1), f(), f(3)),
                placement,
                local,
            )
        ],
    }


SMALL = gan.GanConfig(
    GeneratorConfig(16, "R", 32, 4, channels=4, layers=4, waves=2, drift=1.0, z=4, w=4, height_rows=8, height_width=4),
    DiscriminatorConfig(8, 64, 4, embedding=4),
    PictureConfig(8, 4, texels=16, height_rows=8, octaves=1),
    trunk=(4,),
    head=(4,),
    batch=4,
    blur=1.0,
    density=1.0,
    mismatch=1.0,
)
GAN = gan.sized_for(SMALL, appearance=1, geometry=1)
PLANES = gan.sized_for(replace(SMALL, generator=replace(SMALL.generator, planes=3, config="T")), 1, 1)
SHORT = gan.sized_for(replace(SMALL, precision="bfloat16", views=2), 1, 1)
HEADS = gan.sized_for(replace(SMALL, discriminator=replace(SMALL.discriminator, kind="vision-aided")), 1, 1)
SHOWN = ImageBatch(
    f(4, 8, 8, 4), f(4, 1), f(4, 1), f(4, 4, 4), f(4, 3), f(4, 3), jax.ShapeDtypeStruct((4, 2), jnp.uint32)
)
PARAMETRIC = parametric.NerfTexConfig(SMALL.picture, (8,), (8,), octaves=2, batch=4, parameters=2)


def _of_generators() -> Programs:
    config, state = GAN.generator, jax.eval_shape(lambda: gan.start(GAN, KEY))
    generator, averages = (
        jax.eval_shape(make) for make in (lambda: init_generator(config, KEY), lambda: init_averages(config))
    )
    phases = jax.eval_shape(lambda: draw_phases(config, KEY, 1))
    one, nodes = (model.Latent(w, phases) for w in (f(1, 4), f(1, 9, 9, 4)))
    tile = partial(_jitted, bake._tile, config, 16, generator, averages)
    slow = jnp.zeros((2, 2), jnp.int32)
    return {
        "shell.generator.bake._averaged": [_jitted(bake._averaged, f(8, 1, 4))],
        "shell.generator.bake._levels": [_jitted(bake._levels, f(16, 16, 4), (16, 8), 3)],
        "shell.generator.bake._height": [_jitted(bake._height, config, generator, f(1, 4))],
        "shell.generator.bake._tile": [tile(one, i(2)), tile(nodes, i(2))],
        "train.export._patch": [
            _jitted(export._patch, c.generator, begun.generator, init_averages(c.generator), begun.decoder, 2)
            for c, begun in ((c, jax.eval_shape(lambda c=c: gan.start(c, KEY)).learner) for c in (GAN, PLANES))
        ],
        "train.gan.snapshot._pictures": [
            _jitted(snapshot._pictures, GAN, (0, 0), state.learner, averages, SHOWN, None)
        ],
        "train.gan.snapshot._feature": [_jitted(snapshot._feature, GAN, 16, state.learner, averages, SHOWN)],
        "measure.equivariance._made": [_jitted(equivariance._made, config, generator, averages, f(1, 4), phases)],
        "shell.generator.generator.map_latent": [_plain(map_latent, generator, f(1, 4), f(1, 1))],
        "signal.fourier.shifted_phase": [_plain(lambda p, s: shifted_phase(slow, slow, p, s), f(1, 5, 2), f(2))],
    }


def _of_beginnings() -> Programs:
    """Random weights."""
    surface_config = surface_material.SurfaceConfig(8, 3, (8,))
    return {
        "shell.material.decoder.init_decoder": [_jitted(init_decoder, KEY, 4, (4,), (4,))],
        "shell.generator.generator.init_generator": [_jitted(init_generator, GAN.generator, KEY)],
        "shell.generator.discriminator.init_discriminator": [_jitted(init_discriminator, GAN.discriminator, KEY)],
        "surface_material.network.init_surface": [_jitted(surface_material.init_surface, surface_config, KEY)],
        "neutex.field.init_field": [_jitted(init_field, FieldConfig((8,), (8,), (8,), (8,), 8, "hash"), KEY)],
    }


def _of_surfaces() -> Programs:
    found: Programs = {}
    for config in (surface_material.SurfaceConfig(8, 3, (8,), opacity=o) for o in ("direct", "cosine")):
        made = jax.eval_shape(lambda c=config: surface_material.init_surface(c, KEY))
        table = jax.eval_shape(surface_material.blur_textures, made, f())
        training = surface.SurfaceTrainConfig(config, batch=64)
        state = jax.eval_shape(lambda t=training: surface.start(t, KEY))
        rows = f(ROWS, 2), f(ROWS), f(ROWS, 3), f(ROWS)
        asked = surface.QueryBatch(f(64, 2), f(64), f(64, 3), f(64), f(64, 3), f(64), f(64), f(64, 3))
        programs = {
            "surface_material.renderer._ask_opacity": _jitted(surface_renderer._ask_opacity, config, table, rows, i()),
            "surface_material.renderer._ask": _jitted(
                surface_renderer._ask, config, table, (*rows, f(ROWS, 2, 3)), i()
            ),
            "surface_material.network.blur_textures": _jitted(surface_material.blur_textures, made, f()),
            "stability.surface_material._answers": _jitted(
                surface_material_checks._answers, config, table, (*rows, f(ROWS, 3))
            ),
            "train.surface.snapshot._current": _jitted(surface_snapshot._current, training, state, asked),
            "train.surface.snapshot._answers": _jitted(surface_snapshot._answers, training, made, asked),
            "train.surface.step.step": _plain(partial(surface.step, training), state, asked),
        }
        found = {name: [*found.get(name, []), program] for name, program in programs.items()}
    return found


def _of_objects() -> Programs:
    small: Any = {"octaves": (2, 2, 1), "hash": HashConfig(3, 2, 8, 4, 12)}
    colours, encodings = ("texture", "volume", "reflectance"), ("hash", "frequency", "hash")
    found: Programs = {}
    for colour, encoding in zip(colours, encodings, strict=True):
        config = FieldConfig((8, 8), (8,), (8, 8), (8, 8), 8, encoding, colour=colour, flash=1.0, **small)  # type: ignore[arg-type]
        field = jax.eval_shape(lambda c=config: init_field(c, KEY))
        occupied, y, image = b(32, 32, 32), f(1024, 3), f(4, 8, 6)
        lit = (f(1024, 2, 3), f(1024, 2, 3)) if colour == "reflectance" else ()
        form, thing = (
            atlas_render.StaticConfig(config, 8, "latlong", True),
            atlas_render.FieldArrays(field, occupied, f(), image),
        )
        training = atlas.NeuTexTrainConfig(config, side=16, samples=8, batch=16, kimg=0.16, cloud=True)
        state = jax.eval_shape(lambda t=training: atlas.start(t, KEY))
        rays = Rays(f(16, 3), f(16, 3), f(16, 3), f(16), i(16), f(16, 3), f(16, 3))
        programs = {
            "neutex.render._greatest": _jitted(atlas_render._greatest, config, field),
            "neutex.render._tiles": _jitted(atlas_render._tiles, form, thing, f(1024, 3), f(1024, 3), *lit, i()),
            "neutex.render._meets": _jitted(atlas_render._meets, occupied, f(ROWS, 3), f(ROWS, 3), i()),
            "neutex.mesh._surface_near": _jitted(mesh._surface_near, config, field, f(ROWS, 3), f(ROWS, 3), i()),
            "neutex.mesh._surface": _jitted(mesh._surface, field, y),
            "measure.captured._there": _jitted(captured._there, field, y),
            "train.neutex.step.step": _plain(partial(atlas.step, training), state, rays),
        }
        if colour != "volume":
            programs["neutex.edit._greatest"] = _jitted(paint._greatest, config, "colour", field, f(2, 3), y)
        if colour == "reflectance":
            programs["neutex.render._normals"] = _jitted(atlas_render._normals, config, field, f(ROWS, 3), i())
        found |= {name: [*found.get(name, []), program] for name, program in programs.items()}
    return found


def _of_training() -> Programs:
    def steps(config: gan.GanConfig) -> Callable[[], Any]:
        return _plain(partial(gan_step.step, config), jax.eval_shape(lambda: gan.start(config, KEY)), SHOWN)

    fitting = FitConfig(
        texels=16, channels=4, height_rows=8, octaves=1, trunk=(8,), head=(8,), batch=2, rays=256, candidates=16
    )
    fitting = replace(fitting, appearance=1)
    nothing = np.zeros((0, 1), np.float32)
    pictures = FitData(Path(), "", {}, (), np.zeros(1, int), np.zeros((0, 4), np.float16), (), (), nothing, nothing, ())
    begun = jax.eval_shape(lambda: fit.start(fitting, pictures, KEY))
    rays = patch_rays.Rays(
        i(2), f(2, 256, 3), f(2, 256, 3), f(2, 256), f(2, 256, 3), f(2, 256, 3), f(2, 256, 1), f(2, 256, 4), u(2, 2)
    )
    row = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), rays)
    material = jax.eval_shape(lambda s: material_of(s.common, s.own.feature[0]), begun)
    network = jax.eval_shape(lambda: parametric.start(PARAMETRIC, KEY))
    judge = efficientnet.Conv(f(3, 3, 4, 4), f(4))
    return {
        "train.parallel._by_jit": [
            *map(steps, (GAN, PLANES, SHORT, HEADS)),
            _plain(partial(parametric.step, PARAMETRIC), network, SHOWN),
            _plain(partial(fit.step, fitting), begun, rays),
        ],
        "train.parallel._by_pmap": [],  # the same steps
        "train.nerf_tex.snapshot._pictures": [
            _jitted(parametric_snapshot._pictures, PARAMETRIC, network.decoder, SHOWN)
        ],
        "train.fit.holdout._row": [
            _plain(partial(predict, fitting.layout, 0.45), material, row, f(4, 4, 4), f(256, 16))
        ],
        **_of_textures(),
        "measure.features._batched": [
            _plain(lambda w, x: inception._conv({"x": w}, "x", x), (f(3, 3, 4, 4), f(4)), f(1, 8, 8, 4)),
            _plain(efficientnet._convolved, judge, f(1, 8, 8, 4)),
        ],
    }


def _of_textures() -> Programs:
    """A generator that learns exemplars, with a critic; what its start and its sheets compile are parts of the same."""
    small = GeneratorConfig(texels=32, channel_base=256, channel_max=8, channels=4, layers=4, z=0, w=8, waves=2)
    config = TexturesConfig(replace(small, height_rows=8), batch=2, adversarial=True, window=64, octaves=1, alphas=1)
    decoder = init_decoder(KEY, 4 + 1 + 2 + 1, (8,), (8,))
    arrays = np.ones((2, 32, 32, 4), np.float32), np.ones((8, 4), np.float32), np.zeros((2, 0), np.float32)
    data = scale_exemplars(Exemplars(*arrays, decoder_arrays(decoder), 1, (), {}))
    begun = jax.eval_shape(lambda: textures.start(config, data, KEY))
    batch = ExemplarBatch(i(2), f(2, 64, 64, 4), f(2, 0), u(2, 2))
    phases = jax.eval_shape(lambda p: synthesis.own_phases(config, p), i(2))
    shown = _jitted(textures_snapshot._shown, 1, 1, decoder, f(32, 32, 4), f(8, 4))
    return {
        "train.textures.natural_start._natural": [
            _jitted(natural_start._natural, config.generator, (2, 1, 1), f(2, 32, 32, 4), KEY)
        ],
        "train.textures.adversarial.begun": [
            _jitted(adversarial.begun, config, begun, f(2, 32, 32, 4), KEY),
            _plain(partial(textures.step, config), begun, batch),
        ],
        "train.textures.synthesis._moments": [_jitted(synthesis._moments, config, begun, KEY)],
        "train.textures.snapshot._made": [_jitted(textures_snapshot._made, config, begun, f(2, 0), phases)],
        "train.textures.snapshot._shown": [shown],
    }


def _of_corrections(bundle: Bundle) -> Programs:
    device_material = loader.load_device_material(bundle)
    views, row = (
        prefilter.View(f(4, 3), f(4, 3), f(4, 1), f(4, 3, 4)),
        f(2, device_material.material.height.rows.shape[1]),
    )
    held, rest = (device_material.layout, (2, 8), device_material.material), (row, f(), views, KEY)
    return {
        "train.prefilter._true": [_jitted(prefilter._true, *held, views[:3], jax.random.split(KEY, 4))],
        "train.prefilter._slope": [
            _jitted(prefilter._slope, device_material.layout, 8, device_material.material, *rest)
        ],
        "train.prefilter._halves": [_jitted(prefilter._halves, *held, *rest)],
        "train.prefilter._updated": [
            _jitted(prefilter._updated, row, row, jax.eval_shape(prefilter._ADAM.init, row), f())
        ],
    }


def _of_judges(bundle: Bundle) -> Programs:
    found, how = loader.load_device_material(bundle), ((1, 4), 2)
    picture = _jitted(above._picture, found.layout, (*how, (0.0, 0.0, 1.0)), found.material, f(1))
    return {
        "measure.above._picture": [picture],
        "measure.above._opacities": [_jitted(above._opacities, found.layout, how, found.material, f(1))],
        "measure.posed._fitted.batch": [],  # pictures as the GAN's step takes them
    }
