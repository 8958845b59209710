"""`mesoshell atlas train`, `texture`, `render` and `mesh`: from photographs to an object. Imports JAX."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np

from mesoshell.cli.checks import at_least, ends_in, requires
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.learn import learn, print_length
from mesoshell.cli.options.atlas import Mesh, Render, Texture, Train
from mesoshell.cli.progress import bar, stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import probe_folder, probe_outputs, replace_file
from mesoshell.io.image import write_exr, write_png
from mesoshell.io.mesh_export import write_textured_mesh
from mesoshell.io.records import read_object
from mesoshell.limits import check_memory
from mesoshell.neutex import edit as paint
from mesoshell.neutex.cameras import Photo, around
from mesoshell.neutex.capture import read_capture
from mesoshell.neutex.mesh import extract_mesh
from mesoshell.neutex.render import Lighting, picture, view
from mesoshell.neutex.store import MAX_SAMPLES, NeuTexModel, read_neutex
from mesoshell.scene.setup import check_irradiance, environment_of, light_of
from mesoshell.train.experiment import read_experiment, with_kimg
from mesoshell.train.gan.presets import PRESETS as SIZES
from mesoshell.train.neutex.step import NeuTexTrainConfig, neutex_config
from mesoshell.train.run_config import read_record, snapshots

#: In a folder of frames: how many there are.
RECORD = "frames.json"


def train(options: Train) -> None:
    """`mesoshell atlas train`."""
    keep_compiled()
    config = with_kimg(_config(options), options.kimg)
    with stderr().status("reading photographs"):
        capture = read_capture(options.capture, options.background, config.side)
    print_length(options.run, learn(config, capture, options.run))


def texture(options: Texture) -> None:
    """`mesoshell atlas texture`."""
    ends_in(options.out, *((".png", ".exr") if options.part == "colour" else (".exr",)))
    at_least(options, size=1)
    _check_size(options)
    probe_outputs((options.out,))
    model = _read_textured(options.object)
    if options.part != "colour" and model.config.colour != "reflectance":
        raise InputError(options.object, f"has colours as photographed, but no {options.part}")
    image = paint.texture_image(model, options.layout, options.size, options.part)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write = write_png if options.out.suffix.lower() == ".png" else write_exr
    write(options.out, image)
    print(f"{options.out}: {image.shape[1]} x {image.shape[0]}, {options.layout}")


def render(options: Render) -> None:
    """`mesoshell atlas render`."""
    if options.checker and options.texture:
        raise InputError("--checker", "cannot be combined with --texture")
    requires(options, "texture", "edit", "layout")
    requires(options, "light", "irradiance")
    requires(options, "environment", "up")
    at_least(options, frames=1, samples=1, size=1)
    if (options.samples or 0) > MAX_SAMPLES:
        raise InputError("--samples", f"must be at most {MAX_SAMPLES}, not {options.samples}")
    keep_compiled()
    probe_folder(options.out, "--out")
    model = _read_textured(options.object) if options.checker or options.texture else _read_model(options.object)
    painted = paint.board_paint() if options.checker else None
    if options.texture:
        layout, image = paint.read_edit(options.texture, options.layout)
        painted = paint.paint_of(model, layout, image, options.edit)
    quality = model.quality(options.quality)
    if options.samples is not None:
        quality = quality.with_changes(samples=options.samples)
    cameras = _cameras(model, options)
    how = view(model.config, model.field, quality, painted, _lit(model, options))
    options.out.mkdir(parents=True, exist_ok=True)
    there = _frames(options.out / RECORD)  # that this verb rendered here
    replace_file(options.out / RECORD, json.dumps({"frames": max(there, len(cameras))}).encode())
    with bar(stderr(), "rendering", len(cameras), count=True) as show:
        for i, camera in enumerate(cameras):
            rgba = picture(model.config, model.field, model.to_box(camera), how).rgba
            write_exr(options.out / f"{i:04d}.exr", rgba)
            write_png(options.out / f"{i:04d}.png", rgba)
            show(i + 1)
    for i in range(len(cameras), there):  # of a longer path
        for suffix in (".exr", ".png"):
            (options.out / f"{i:04d}{suffix}").unlink(missing_ok=True)
    replace_file(options.out / RECORD, json.dumps({"frames": len(cameras)}).encode())
    print(f"{options.out}: {len(cameras)} frames")


def _frames(record: Path) -> int:
    """How many frames a folder holds that this verb rendered."""
    try:
        return int(read_object(record)["frames"])
    except (InputError, KeyError, TypeError, ValueError):
        return 0


def mesh(options: Mesh) -> None:
    """`mesoshell atlas mesh`."""
    ends_in(options.out, ".glb", ".obj")
    at_least(options, size=1, quads=1)
    _check_size(options)
    check_memory("--quads", f"a wrap of 6 x {options.quads} x {options.quads} quads", 6 * 512 * options.quads**2)
    probe_outputs((options.out,))
    model, side = _read_textured(options.object), options.size
    surface = extract_mesh(model.config, model.field, options.quads, side)
    image = paint.texture_image(model, "cubemap", side)
    rough = None
    if model.config.colour == "reflectance" and options.out.suffix.lower() == ".glb":
        rough = paint.texture_image(model, "cubemap", side, "roughness")[..., 0]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    vertices = model.centre + model.half * surface.vertices
    write_textured_mesh(options.out, vertices, surface.faces, surface.uv, surface.normals, image, rough)
    print(f"{options.out}: {len(surface.faces)} triangles, texture {image.shape[1]} x {image.shape[0]}")


def _lit(model: NeuTexModel, options: Render) -> Lighting | None:
    """The lights that are given, or None for the camera's flash."""
    if not (options.light or options.environment):
        return None
    if model.config.colour != "reflectance":
        raise InputError(options.object, "has colours as photographed, but no reflectance to light")
    check_irradiance("irradiance", np.array(options.irradiance))
    lights = tuple(light_of(toward, options.irradiance) for toward in options.light)
    return Lighting(lights, environment_of(options.environment, {"y": 1, "z": 2}[options.up]))


def _config(options: Train) -> NeuTexTrainConfig:
    """The experiment's configuration at the preset's size, or the preset's own, with this encoding."""
    if options.experiment is None:
        return neutex_config(SIZES[options.preset], options.encoding)
    if options.encoding is not None:
        raise InputError("--encoding", "cannot be combined with --experiment, which sets it")
    config = read_experiment(options.experiment, options.preset)
    if not isinstance(config, NeuTexTrainConfig):
        raise InputError(options.experiment, "its `variant` must make an NeuTexTrainConfig")
    return config


def _read_model(path: Path) -> NeuTexModel:
    """The model in a snapshot, or in the newest snapshot of a run."""
    if not path.is_dir():
        return read_neutex(path)
    if not isinstance(read_record(path)[0], NeuTexTrainConfig):
        raise InputError(path, "was not made by `mesoshell atlas train`")
    return read_neutex(snapshots(path)[-1][1])


def _read_textured(path: Path) -> NeuTexModel:
    model = _read_model(path)
    if model.config.colour == "volume":
        raise InputError(path, "has its colours in the volume, but no texture")
    return model


def _cameras(model: NeuTexModel, options: Render) -> list[Photo]:
    usual = {field.name: field.default for field in fields(Render)}
    for name in ("size", "frames") if options.path != "orbit" else ():
        if getattr(options, name) != usual[name]:
            raise InputError(f"--{name}", f"is of an orbit; --path {options.path} has the photographs' own")
    if options.path == "photographs":
        return list(model.photos)
    if options.path == "held-out":
        if not model.tested:
            raise InputError(options.object, "has no photographs held out: there are fewer than 8")
        return [model.photos[i] for i in model.tested]
    width, height = options.size
    check_memory("--size", f"frames of {width} x {height}", 64 * width * height)
    check_memory("--frames", f"{options.frames} cameras", 512 * options.frames)
    try:
        return around(model.photos, model.centre, options.frames, options.size)
    except ValueError as fault:
        raise InputError("--path", f"{fault}: choose photographs or held-out") from None


def _check_size(options: Texture | Mesh) -> None:
    """Raise InputError if memory does not hold a texture of six squares, the most of any layout."""
    check_memory("--size", f"a texture of {options.size} pixels a side", 6 * 64 * options.size**2)
