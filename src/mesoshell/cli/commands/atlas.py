"""The work of `mesoshell atlas` after the photographs are there. Imports JAX, so it is loaded only when it runs."""

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from mesoshell.atlas import paint
from mesoshell.atlas.capture import read_capture
from mesoshell.atlas.mesh import wrapped
from mesoshell.atlas.photo import Photo, orbit
from mesoshell.atlas.render import Lit, picture, view
from mesoshell.atlas.store import Captured, read_captured
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.learn import learn, said
from mesoshell.cli.options.atlas import Mesh, Render, Texture, Train
from mesoshell.errors import InputError
from mesoshell.io.image import read_exr, write_exr, write_png
from mesoshell.io.whole import probe_folder, probe_outputs
from mesoshell.io.wrapped import write_wrapped
from mesoshell.limits import check_memory
from mesoshell.render.light import Distant, environment
from mesoshell.render.quality import PRESETS
from mesoshell.train.atlas import AtlasTraining, atlas_as
from mesoshell.train.atlas_snapshot import board_paint
from mesoshell.train.experiment import of_length, read_experiment
from mesoshell.train.presets import PRESETS as SIZES
from mesoshell.train.record import read_record, snapshots


def train(options: Train) -> None:
    """`mesoshell atlas train`."""
    keep_compiled()
    config = of_length(_config(options), options.kimg)
    console = Console(stderr=True, highlight=False)
    with console.status("reading photographs"):
        capture = read_capture(options.capture, options.background, config.side)
    said(options.run, learn(config, capture, options.run))


def texture(options: Texture) -> None:
    """`mesoshell atlas texture`."""
    _suffix(options.out, (".png", ".exr") if options.part == "colour" else (".exr",))
    probe_outputs((options.out,))
    found, size = _textured(options.object), _side(options.size)
    if options.part != "colour" and found.config.colour != "reflectance":
        raise InputError(options.object, f"has colours as they were photographed, and no {options.part}")
    image = paint.texture_image(found, options.layout, size, options.part)
    _folder(options.out.parent)
    write = write_png if options.out.suffix.lower() == ".png" else write_exr
    write(options.out, image)
    print(f"{options.out}: {image.shape[1]} x {image.shape[0]}, {options.layout}")


def render(options: Render) -> None:
    """`mesoshell atlas render`."""
    if options.checker and options.texture:
        raise InputError("--checker", "stands in the texture's place: give one of --checker and --texture")
    keep_compiled()
    probe_folder(options.out, "--out")
    found = _textured(options.object) if options.checker or options.texture else _found(options.object)
    painted = board_paint() if options.checker else None
    if options.texture:
        layout, image = paint.read_edit(options.texture, options.layout)
        painted = paint.painted(found, layout, image, options.edit)
    quality = PRESETS[options.quality]
    samples = options.samples
    if samples is None:
        learned = int(found.provenance.get("config", {}).get("samples", quality.samples))
        samples = max(learned, quality.samples) if options.quality == "reference" else learned
    quality = quality.with_changes(samples=_at_least_one("--samples", samples))
    cameras = _cameras(found, options)
    how = view(found.config, found.field, quality, painted, _lit(found, options))
    _folder(options.out)
    console = Console(stderr=True)
    for i, camera in enumerate(track(cameras, "rendering", console=console, transient=True)):
        rgba = picture(found.config, found.field, found.to_box(camera), how).rgba
        write_exr(options.out / f"{i:04d}.exr", rgba)
        write_png(options.out / f"{i:04d}.png", rgba)
    for old in options.out.glob("[0-9][0-9][0-9][0-9].exr"):  # of a longer path that was rendered here before
        shown = old.with_suffix(".png")
        if int(old.stem) >= len(cameras) and shown.exists():
            old.unlink()
            shown.unlink()
    print(f"{options.out}: {len(cameras)} frames")


def mesh(options: Mesh) -> None:
    """`mesoshell atlas mesh`."""
    _suffix(options.out, (".glb", ".obj"))
    probe_outputs((options.out,))
    found, side, quads = _textured(options.object), _side(options.size), _at_least_one("--quads", options.quads)
    check_memory("--quads", f"a wrap of 6 x {quads} x {quads} quads", 6 * 512 * quads**2)
    surface = wrapped(found.config, found.field, quads, side)
    image = paint.texture_image(found, "cubemap", side)
    rough = None
    if found.config.colour == "reflectance" and options.out.suffix.lower() == ".glb":
        rough = paint.texture_image(found, "cubemap", side, "roughness")[..., 0]
    _folder(options.out.parent)
    vertices = found.centre + found.half * surface.vertices
    write_wrapped(options.out, vertices, surface.faces, surface.uv, surface.normals, image, rough)
    print(f"{options.out}: {len(surface.faces)} triangles, texture {image.shape[1]} x {image.shape[0]}")


def _lit(found: Captured, options: Render) -> Lit | None:
    """Other light than the camera's, if some is asked for."""
    if not (options.light or options.environment):
        return None
    if found.config.colour != "reflectance":
        raise InputError(options.object, "has colours as they were photographed, and no reflectance that could be lit")
    if not (np.isfinite(options.irradiance) and options.irradiance >= 0):
        raise InputError("--irradiance", f"must be finite and not negative, not {options.irradiance}")
    lights = []
    for v in options.light:
        length = float(np.linalg.norm(v))
        if not (np.isfinite(length) and length > 0):
            raise InputError("--light", f"{v} is no direction")
        lights.append(Distant(np.array(v) / length, np.full(3, options.irradiance)))
    sky = None
    if options.environment:
        radiance = read_exr(options.environment)[..., :3]
        if not (np.isfinite(radiance).all() and (radiance >= 0).all() and radiance.any()):
            raise InputError(
                options.environment, "is no environment: it has negative or infinite pixels, or is all black"
            )
        sky = environment(radiance, {"y": 1, "z": 2}[options.up])
    return Lit(tuple(lights), sky)


def _config(options: Train) -> AtlasTraining:
    """The experiment's at the preset's size, or the preset's own with the encoding."""
    if options.experiment is None:
        return atlas_as(SIZES[options.preset], options.encoding)
    if options.encoding is not None:
        raise InputError("--encoding", "is the experiment's to say: give one of --encoding and --experiment")
    config = read_experiment(options.experiment, options.preset)
    if not isinstance(config, AtlasTraining):
        raise InputError(options.experiment, "is of another way to learn: its `variant` makes no AtlasTraining")
    return config


def _found(path: Path) -> Captured:
    """A snapshot, or a run's newest."""
    if not path.is_dir():
        return read_captured(path)
    if not isinstance(read_record(path)[0], AtlasTraining):
        raise InputError(path, "is no run of `mesoshell atlas train`")
    return read_captured(snapshots(path)[-1][1])


def _textured(path: Path) -> Captured:
    found = _found(path)
    if found.config.colour == "volume":
        raise InputError(path, "has its colours in the volume, and no texture")
    return found


def _cameras(found: Captured, options: Render) -> list[Photo]:
    if options.path == "photographs":
        return list(found.photos)
    if options.path == "held-out":
        if not found.tested:
            raise InputError(options.object, "held no view out: it has fewer than 8")
        return [found.photos[i] for i in found.tested]
    return around(found, _at_least_one("--frames", options.frames), options.size)


def around(found: Captured, frames: int, size: tuple[int, int]) -> list[Photo]:
    """Cameras on a circle about the mean of the photographs' upward directions, as high and as far off as these are in the
    middle, with the first one's angle of view across its shorter side."""
    worlds = np.stack([p.to_world for p in found.photos])
    up = worlds[:, :3, 1].mean(axis=0)
    if not np.linalg.norm(up) > 1e-3:
        raise InputError(
            "--path", "the photographs have no common upward direction to go around: give photographs or held-out"
        )
    up /= np.linalg.norm(up)
    arms = worlds[:, :3, 3] - found.centre
    far, high = np.median(np.linalg.norm(arms, axis=1)), np.median(arms @ up / np.linalg.norm(arms, axis=1))
    sides = arms - np.outer(arms @ up, up)
    side = sides[np.argmax(np.linalg.norm(sides, axis=1))]
    arm = far * (high * up + np.sqrt(max(1 - high**2, 0)) * side / max(np.linalg.norm(side), 1e-9))
    width, height = (_at_least_one("--size", n) for n in size)
    check_memory("--size", f"frames of {width} x {height}", 64 * width * height)
    check_memory("--frames", f"{frames} cameras", 512 * frames)
    first = found.photos[0]
    f = first.lens[1] / min(first.width, first.height) * min(width, height)
    lens = f, f, width / 2, height / 2
    return [Photo(orbit(found.centre, up, arm, 2 * np.pi * i / frames), lens, width, height) for i in range(frames)]


def _suffix(path: Path, allowed: tuple[str, ...]) -> None:
    if path.suffix.lower() not in allowed:
        raise InputError(path, f"must end in {' or '.join(allowed)}")


def _folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(path, f"cannot be made: {error.strerror}") from error


def _side(n: int) -> int:
    """Of the squares of a texture, which its layout has six of at most."""
    check_memory("--size", f"a texture of {n} pixels a side", 6 * 64 * _at_least_one("--size", n) ** 2)
    return n


def _at_least_one(name: str, n: int) -> int:
    if n < 1:
        raise InputError(name, f"must be at least 1, not {n}")
    return n
