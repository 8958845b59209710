"""What grows on a mesh of a scene: its shell, and the material with its texture (loads JAX only to grow one).

`one` is a Scene, for its own material, or one of its `also`: both have a mesh, a material, and what is set of it.
"""

import hashlib
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os.path import isfile
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.geometry.mesh import Mesh
from mesoshell.geometry.refine import at_vertices, levels_for, pixels_an_edge, refine
from mesoshell.io.bundle import Bundle
from mesoshell.io.corner_tiles import seed_origin
from mesoshell.io.image import read_heights
from mesoshell.io.material import PARAMS, parameter_vector
from mesoshell.io.surface import KIND
from mesoshell.kept import constant, kept
from mesoshell.limits import check_seed, checked_latent
from mesoshell.scene.kept_meshes import mesh_of
from mesoshell.scene.materials import Image, read_params
from mesoshell.scene.scene import Grown, Scene
from mesoshell.shell.geometry.chart import span, texture_origin
from mesoshell.shell.geometry.extrude import Shell, extrude, patches_per_uv, proportions
from mesoshell.surface_material.scene import SurfacePart, default_period

#: Share of the thickness below which a face carries nothing, and that its vertices have at least where it carries something.
LEAST = 0.02
#: Pixels along an edge of the mesh above which a note says how coarsely an image of growth is read.
COARSE = 4.0
#: What grew last by images, for the next pictures of the same scenes.
_KEPT: deque = deque(maxlen=4)


@dataclass(frozen=True, eq=False)
class Growth:
    """A mesh under its shell, and what grows there. origin: where the texture begins, (u, v) in patches; alpha: normalised
    parameters; maps: those that vary, (H, W) over the UV square; notes: what the user should know, a line each."""

    mesh: Mesh
    shell: Shell
    material: Bundle
    origin: tuple[int, int]
    alpha: Float[np.ndarray, "_"]
    maps: dict[str, Float[np.ndarray, "_ _"]]
    patches_per_uv: float
    notes: tuple[str, ...]


def growth_of(part: Scene | Grown, progress: Callable[[float], None] = lambda share: None) -> Growth:
    """What grows, its texture grown. progress: of that. Raises InputError."""
    mesh, shell, uv, said = _extruded(part)
    bundle = part.material.shell
    values, maps = read_params(bundle, part.params)
    patches = patches_per_uv(mesh, shell)
    shape = {p.name: maps.pop(p.name) for p in bundle.parameters if p.role == "beta" and p.name in maps}
    repeats = bool(mesh.uv.min() < 0 or mesh.uv.max() > 1)
    material, origin, notes = _textured(part, uv, (values, shape, patches, repeats), progress)
    alpha = parameter_vector(bundle, values)
    return Growth(mesh, shell, material, origin, alpha, maps, patches, (*mesh.notes, *shell.notes, *said, *notes))


def check_growth(part: Scene | Grown) -> tuple[str, ...]:
    """Raise InputError as `growth_of` does, but grow no texture. What the user should know, a line each."""
    if part.material.kind == KIND:
        return surface_part(part).mesh.notes
    if not grows(part):
        return growth_of(part).notes
    mesh, shell, _, said = _extruded(part)
    parameter_vector(part.material.shell, read_params(part.material.shell, part.params)[0])
    return *mesh.notes, *shell.notes, *said


def surface_part(part: Scene | Grown) -> SurfacePart:
    """A mesh with a surface material, its period by default. Raises InputError."""
    assert part.mesh is not None
    mesh = mesh_of(part.mesh)
    period = default_period(mesh) if part.scale is None else part.scale
    if not (np.isfinite(period) and period > 0):
        raise InputError(Argument("scale"), f"must be above 0, not {period:g}")
    return SurfacePart(mesh, period, part.material.surface)


def thickness_and_scale(part: Scene | Grown, mesh: Mesh) -> tuple[float, float]:
    """As given, or by default (world). Raises InputError."""
    return proportions(mesh, part.material.shell.thickness, part.thickness, part.scale)


def grows(part: Scene | Grown) -> bool:
    """Whether a texture must be grown: another is called for than the material holds."""
    if part.material.kind == KIND:
        return False
    bundle = part.material.shell
    geometry = any(p.role == "beta" and p.name in part.params for p in bundle.parameters)
    others = part.seed is not None or latent_of(part) is not None
    return bundle.generator is not None and (not bundle.baked or others or geometry)


def latent_of(part: Scene | Grown) -> tuple[int, float] | None:
    """Another seed and its share of z, above 0. Raises InputError."""
    return checked_latent(part.latent, part.material.name, part.material.shell.latent_size)


@contextmanager
def faults_of(part: Grown) -> Iterator[None]:
    """Faults within say of which of `also` they are: NAME:ARGUMENT."""
    try:
        yield
    except InputError as fault:
        if not isinstance(fault.source, Argument):
            raise
        own = Argument(f"{part.called}:{fault.source}")
        raise InputError(own, fault.fault.replace("`", "")) from fault


def meshes_of(scene: Scene) -> list[Mesh]:
    """All meshes that something grows on, the scene's own first. Raises InputError."""
    return [mesh_of(part.mesh) for part in (scene, *scene.also) if part.mesh is not None]


class _Grown(NamedTuple):
    """A mesh, perhaps refined, its shell, all that a texture must cover, patches, and what the user should know."""

    mesh: Mesh
    shell: Shell
    uv: Float[np.ndarray, "N 3 2"]
    notes: tuple[str, ...] = ()


def _extruded(part: Scene | Grown) -> _Grown:
    check_seed(part.seed)
    latent_of(part)
    assert part.mesh is not None  # scene/unpack gives those that are named in a file
    mesh = mesh_of(part.mesh)
    thickness, scale = thickness_and_scale(part, mesh)
    if part.growth is None:
        shell = _even_shell(mesh, thickness, scale)
        return _Grown(mesh, shell, shell.uv)
    image = growth_image(part.growth)
    how = hashlib.sha256(image.tobytes()).digest(), image.shape, thickness, scale
    made = next((made for of, by, made in tuple(_KEPT) if of is mesh and by == how), None)
    if made is None:
        made = _grown_by(image, mesh, thickness, scale)
        _KEPT.append((mesh, how, made))
    return made


@kept
def _even_shell(mesh: Mesh, thickness: float, scale: float) -> Shell:
    return constant(extrude(mesh, thickness, scale))


def _grown_by(image: Float[np.ndarray, "H W"], mesh: Mesh, thickness: float, scale: float) -> _Grown:
    """As high as an image is bright."""
    levels = levels_for(mesh, image.shape)
    mesh = constant(refine(mesh, levels)) if levels else mesh
    share = at_vertices(mesh, image)
    bare = np.all(share[mesh.faces] < LEAST, axis=1)
    if bare.all():
        raise InputError(Argument("growth"), "is black everywhere on the mesh: nothing grows")
    shell = constant(extrude(mesh, thickness * np.maximum(share, LEAST), scale, bare))
    covered = np.union1d(np.flatnonzero(bare), shell.mesh_face)  # so that what is mown elsewhere moves nothing
    uv = (mesh.uv[covered].astype(np.float64) * patches_per_uv(mesh, shell)).astype(np.float32)
    apart, notes = pixels_an_edge(mesh, image.shape), ()
    if apart > COARSE:
        notes = (f"growth is read every {apart:.0f} of its pixels: the mesh has {len(mesh.faces)} triangles for it",)
    return _Grown(mesh, shell, uv, notes)


def growth_image(given: Image) -> Float[np.ndarray, "H W"]:
    """Heights from 0 to 1, of a file or an array. Raises InputError."""
    if isinstance(given, np.ndarray):
        image = given
    elif isfile(given):
        image = read_heights(given)
    else:
        raise InputError(Argument("growth"), f"{given} is no image file")
    if image.ndim != 2 or not image.size or not ((image >= 0) & (image <= 1)).all():
        raise InputError(Argument("growth"), f"must be an image (H, W) from 0 to 1; this one is {_described(image)}")
    return image


def _described(image: np.ndarray) -> str:
    known = image.size and np.isfinite(image).all()
    return f"{image.shape}, from {image.min():g} to {image.max():g}" if known else f"{image.shape}"


def _textured(
    part: Scene | Grown,
    uv: np.ndarray,
    wanted: tuple[dict, dict, float, bool],
    progress: Callable[[float], None],
) -> tuple[Bundle, tuple[int, int], list[str]]:
    """The material with a texture for this surface, where the texture begins, and what the user should know. wanted: values of
    parameters, images of geometry, patches a UV unit, and whether images repeat."""
    values, shape, patches, repeats = wanted
    name, bundle = part.material.name, part.material.shell
    if grows(part):
        from mesoshell.shell.generator.texture_synthesis import TextureRequest, field_of, grow

        fields = {key: field_of(image, (patches, patches), repeats) for key, image in shape.items()}
        request = TextureRequest(part.seed or 0, values, fields, latent=latent_of(part))
        return *grow(bundle, name, uv.reshape(-1, 3, 2), request, progress), []
    if part.seed is not None and bundle.tiles is None:
        raise InputError(Argument("seed"), f"{name} is one texture and has no generator")
    fixed = [p.name for p in bundle.parameters if p.role == "beta" and p.name in values | shape]
    if fixed:
        raise InputError(PARAMS, f"{fixed[0]} is baked into {name}, which has no generator")
    if bundle.wraps:
        return bundle, seed_origin(part.seed or 0), []
    (_, (along, across)), (height, width) = span(uv.reshape(-1, 3, 2)), bundle.extent
    small = across > width + 2 or along > height + 2
    note = f"the mesh spans about {across} × {along} patches, the texture {width:g} × {height:g}: "
    return (
        bundle,
        texture_origin(uv.reshape(-1, 3, 2), bundle.extent),
        [note + "its last texels repeat beyond its edges"] if small else [],
    )
