"""Meshes of a USD stage to arrays, in world space (needs the extra `usd`: OpenUSD's own reader).

Notation
prim        of the stage, with a path such as /World/Hill; a Mesh has points, and polygons by their numbers of corners
subset      a GeomSubset: some of a Mesh's polygons, often those of one material
interpolation   of texture coordinates: one a corner (faceVarying), or one a point (vertex, varying)
root, place     where a walk begins, and what takes its parent's space to the world

Read at the stage's first time code. What is invisible, or there for guidance or as a proxy, is left out, and holes; instances,
and points that repeat a prototype, are all there. A mesh that is to be subdivided is taken as its cage. Texture coordinates are
`st`, or the first that are declared as such. A material is its diffuse colour or image, if it is a UsdPreviewSurface.

Sources: OpenUSD's documentation of UsdGeom: Mesh, Imageable, PointInstancer, Primvar, Subset; UsdShade; UsdPreviewSurface.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from os import PathLike, fspath
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.contained import bounded_memory, silent
from mesoshell.errors import InputError
from mesoshell.geometry.colour import Colour, colour_of, image_of, opaque_rgb, read_or_none
from mesoshell.geometry.image_texture import Look, Texture, codes_of
from mesoshell.limits import check_memory, memory

FORMATS = (".usd", ".usda", ".usdc", ".usdz")
SEEN = ("default", "render")
#: Most prims of a walk, instances counted each; of all walks, one for each point of an instancer; instancers within each other.
MAX_PRIMS, MAX_WALKED, MAX_NESTING = 500_000, 2_000_000, 8
#: Diffuse albedo of a UsdPreviewSurface that names none.
GREY = 0.18
#: Inputs of a UsdUVTexture by which it gives its image as it is.
USUAL = {"scale": ((1, 1, 1, 1),), "bias": ((0, 0, 0, 0),), "sourceColorSpace": ("auto", "sRGB")}


class Part(NamedTuple):
    """Some triangles of one material. names: of subsets, of the prim and of those above it; arrays: points, triangles and
    corner UVs; look, material: of the material, and its names; nothing without one."""

    names: list[str]
    arrays: tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"], Float[np.ndarray, "_ 3 2"]]
    look: Look = Look()
    material: Sequence[str] = ()


class _Bound(NamedTuple):
    """Path and name of a material, and its look."""

    names: list[str]
    look: Look


def pxr(name: str) -> Any:
    """A module of OpenUSD's, which declare no types."""
    return import_module(f"pxr.{name}")


@contextmanager
def open_stage(path: str | PathLike[str]) -> Iterator[tuple[Any, Any]]:
    """The stage of a file, and its first time code. Raises InputError if it is not one, or OpenUSD is not installed."""
    try:
        Sdf, Tf, Usd, UsdUtils = (pxr(name) for name in ("Sdf", "Tf", "Usd", "UsdUtils"))
    except ImportError as fault:
        raise InputError(path, "is a USD stage, which requires usd-core: pip install mesoshell[usd]") from fault
    said: Any = UsdUtils.CoalescingDiagnosticDelegate()  # what OpenUSD would print
    stage: Any = None
    try:
        with silent(), bounded_memory(memory() // 2):  # a damaged one asks for anything
            known = Sdf.Layer.Find(fspath(path))  # as it was read before: someone may still hold it
            stage = Usd.Stage.Open(fspath(path))
            if known:
                stage.Reload()
            begins = stage.HasAuthoredMetadata("startTimeCode")
            yield stage, Usd.TimeCode(stage.GetStartTimeCode()) if begins else Usd.TimeCode.EarliestTime()
    except Tf.ErrorException as fault:
        raise InputError(path, "is no USD stage that can be read, or a damaged one") from fault
    finally:
        said.TakeUncoalescedDiagnostics()
        stage = said = None  # or a fault's traceback would hold them


def parts(path: str | PathLike[str], apart: bool = True) -> Sequence[Part]:
    """Each mesh of a stage, with the names of its prim and of those above it, from itself upward: paths and bare names. Of a
    point that repeats a prototype these are its instancer's. apart: whether subsets are parts of their own, with their
    materials."""
    there = memory()
    with open_stage(path) as (stage, time):
        walk = _Walk(path, stage, time, there, apart)
        return list(walk.below(stage.GetPseudoRoot(), np.eye(4), None, 0))


def up_of(path: str | PathLike[str]) -> str:
    """The axis of a stage that is up, "y" or "z"."""
    with open_stage(path) as (stage, _):
        return "z" if pxr("UsdGeom").GetStageUpAxis(stage) == "Z" else "y"


def prims(root: Any, all_of_it: bool = False) -> Iterator[Any]:
    """The prims from a root downward, instances' too, but nothing below an instancer: that stands nowhere itself. all_of_it:
    also what is abstract or has no definition, as prototypes may. Raises ValueError for more than MAX_PRIMS."""
    Usd, UsdGeom = pxr("Usd"), pxr("UsdGeom")
    which = Usd.PrimIsActive & Usd.PrimIsLoaded
    walk = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies(which) if all_of_it else Usd.TraverseInstanceProxies()))
    for count, prim in enumerate(walk):
        if count > MAX_PRIMS:
            raise ValueError(f"it has more than {MAX_PRIMS} prims")
        if prim.IsA(UsdGeom.PointInstancer):
            walk.PruneChildren()
        yield prim


def is_visible(prim: Any, time: Any, root: Any = None) -> bool:
    """Whether a prim and all above it, up to a root, are visible."""
    UsdGeom = pxr("UsdGeom")
    while not prim.IsPseudoRoot():
        own = UsdGeom.Imageable(prim).GetVisibilityAttr() if prim.IsA(UsdGeom.Imageable) else None
        if own and own.Get(time) == UsdGeom.Tokens.invisible:
            return False
        if prim == root:
            break
        prim = prim.GetParent()
    return True


def matrix(usd: Any) -> Float[np.ndarray, "4 4"]:
    """A transform, of columns: OpenUSD's are of rows."""
    return np.array(usd, np.float64).reshape(4, 4).T


class _Walk:
    """What is read of a stage, at a time. there: bytes of memory, without the bound of `open_stage`; apart: as of
    `parts`."""

    def __init__(self, path: str | PathLike[str], stage: Any, time: Any, there: int, apart: bool):
        self.path, self.stage, self.time, self.there = path, stage, time, there
        self.frames, self.triangles, self.walked = pxr("UsdGeom").XformCache(time), 0, 0
        self.apart, self.looks, self.codes = apart, dict[str, tuple[Look, str]](), dict[str, np.ndarray]()

    def below(self, root: Any, place: np.ndarray, names: list[str] | None, depth: int) -> Iterator[Part]:
        """The meshes from a root downward. names: of the outermost instancer, where there is one."""
        UsdGeom = pxr("UsdGeom")
        if depth > MAX_NESTING:
            raise ValueError(f"{root.GetPath()} lies in more than {MAX_NESTING} instancers")
        if not root.IsPseudoRoot():
            place = place @ matrix(self.frames.GetLocalTransformation(root)[0])
        for prim in prims(root, depth > 0):
            self.walked += 1
            if self.walked > MAX_WALKED:
                raise ValueError(f"its instancers repeat more than {MAX_WALKED} prims")
            mesh, instancer = prim.IsA(UsdGeom.Mesh), prim.IsA(UsdGeom.PointInstancer)
            if not (mesh or instancer) or not self.seen(prim, root):
                continue
            to_world = place @ matrix(self.frames.ComputeRelativeTransform(prim, root)[0])
            if mesh:
                arrays, polygon = _mesh(prim, self.time)
                points, faces, uv = _placed(arrays, to_world)
                self.triangles += len(faces)
                check_memory(self.path, f"its {self.triangles} triangles", 200 * self.triangles, self.there)
                if not self.apart:
                    yield Part(names or _names(prim), (points, faces, uv))
                    continue
                for subsets, own in _pieces(prim, polygon, self.time):
                    bound = next((x for x in subsets if x.GetFamilyNameAttr().Get() == "materialBind"), None)
                    names_, look = self.bound(prim if bound is None else bound.GetPrim())
                    inner = [name for x in subsets for name in (str(x.GetPath()), x.GetPrim().GetName())]
                    arrays = (points, faces, uv) if own.all() else _compact(points, faces[own], uv[own])
                    yield Part([*inner, *(names or _names(prim))], arrays, look, names_)
            else:
                for prototype, at in _instances(self.stage, prim, self.time):
                    yield from self.below(prototype, to_world @ at, names or _names(prim), depth + 1)

    def bound(self, prim: Any) -> _Bound:
        """The material that is bound to a prim, kept by its path, of instances by that in their prototype."""
        UsdShade = pxr("UsdShade")
        bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(UsdShade.Tokens.preview)[0]
        if not bound:
            return _Bound([], Look(read_or_none(lambda: _display_colour(prim, self.time))))
        shared = bound.GetPrim().GetPrimInPrototype() if bound.GetPrim().IsInstanceProxy() else bound.GetPrim()
        key = str(shared.GetPath())
        if key not in self.looks:
            self.looks[key] = read_or_none(lambda: _diffuse(bound, self.time, self.codes)) or (Look(), "")
        look, by = self.looks[key]
        if by and by not in [x.GetPrimvarName() for x in _uv_sets(prim)[:1]]:  # other texture coordinates than are read
            look = Look(look.colour)
        return _Bound([str(bound.GetPath()), bound.GetPrim().GetName()], look)

    def seen(self, prim: Any, root: Any) -> bool:
        imageable = pxr("UsdGeom").Imageable(prim)
        return is_visible(prim, self.time, root) and imageable.ComputePurpose() in SEEN


def _names(prim: Any) -> list[str]:
    above = []
    while not prim.IsPseudoRoot():
        above.append(prim)
        prim = prim.GetParent()
    return [name for x in above for name in (str(x.GetPath()), x.GetName())]


def _instances(stage: Any, prim: Any, time: Any) -> Iterator[tuple[Any, Float[np.ndarray, "4 4"]]]:
    """A PointInstancer's prototypes and where they stand in its space. Raises ValueError if its arrays do not fit."""
    UsdGeom = pxr("UsdGeom")
    instancer = UsdGeom.PointInstancer(prim)
    which = _array(instancer.GetProtoIndicesAttr(), time).astype(int)
    roots = [stage.GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetForwardedTargets()]
    places = instancer.ComputeInstanceTransformsAtTime(time, time, UsdGeom.PointInstancer.ExcludeProtoXform) or []
    mask = np.array(instancer.ComputeMaskAtTime(time) or [], bool)
    which = which[mask] if len(mask) == len(which) else which
    if len(places) != len(which) or not all(0 <= k < len(roots) and roots[k] for k in which):
        raise ValueError(
            f"{prim.GetPath()} repeats prototypes that it does not have, or at {len(places)} of {len(which)} places"
        )
    return ((roots[k], matrix(at)) for k, at in zip(which, places, strict=True))


def _pieces(prim: Any, polygon: Int[np.ndarray, "M"], time: Any) -> Iterator[tuple[list[Any], Bool[np.ndarray, "M"]]]:
    """A Mesh's triangles by the subsets of faces that they lie in. polygon: of each triangle."""
    UsdGeom = pxr("UsdGeom")
    kind, members = np.zeros(polygon.max(initial=-1) + 1, np.int64), [[]]
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Mesh(prim)):
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            continue
        own, given = np.zeros(len(kind), bool), _array(subset.GetIndicesAttr(), time).astype(np.int64)
        own[given[(given >= 0) & (given < len(kind))]] = True
        for k in np.unique(kind[own]):
            kind[own & (kind == k)] = len(members)
            members.append([*members[k], subset])
    of_triangle = kind[polygon]
    for k, subsets in enumerate(members):
        own = of_triangle == k
        if own.any():
            yield subsets, own


def _compact(points: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Some faces, with the points that they use alone."""
    used, corner = np.unique(faces, return_inverse=True)
    return points[used], corner.reshape(-1, 3), uv


def _diffuse(material: Any, time: Any, codes: dict[str, np.ndarray]) -> tuple[Look, str]:
    """Of a UsdPreviewSurface, and the name of the texture coordinates of its image, if it says one. codes: of files. Raises an
    exception of any kind for an image that is not there."""
    UsdShade = pxr("UsdShade")
    shader = material.ComputeSurfaceSource()[0]
    if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
        return Look(), ""
    given = shader.GetInput("diffuseColor")
    sources = UsdShade.Utils.GetValueProducingAttributes(given) if given else []
    if not sources:
        return Look((GREY, GREY, GREY)), ""
    if UsdShade.Utils.GetType(sources[0].GetName()) != UsdShade.AttributeType.Output:
        return Look(colour_of(sources[0].Get(time))), ""
    reader = UsdShade.Shader(sources[0].GetPrim())
    file = reader.GetInput("file").Get(time)
    asset = pxr("Ar").GetResolver().OpenAsset(pxr("Ar").ResolvedPath(file.resolvedPath))
    image = image_of(bytes(asset.GetBuffer()))
    by, changed = _coordinates(reader, time), _is_changed(reader, time) or sources[0].GetBaseName() != "rgb"
    mean = _changed_mean(reader, time, image, sources[0].GetBaseName()) if changed else colour_of((1, 1, 1), image)
    if by is None or changed:
        return Look(mean), ""
    if (name := str(file.resolvedPath)) not in codes:
        codes[name] = codes_of(image)
    return Look(mean, Texture(codes[name])), by


def _is_changed(reader: Any, time: Any) -> bool:
    """Whether a UsdUVTexture gives other values than its image has, as light."""
    given = {name: reader.GetInput(name).Get(time) for name in USUAL if reader.GetInput(name)}
    return any(
        x is not None and (x if isinstance(x, str) else tuple(x)) not in USUAL[name] for name, x in given.items()
    )


def _changed_mean(reader: Any, time: Any, image: Any, output: str) -> Colour | None:
    """The mean of what a UsdUVTexture gives by an output: "rgb", or one of its letters."""
    given = {name: reader.GetInput(name).Get(time) if reader.GetInput(name) else None for name in USUAL}
    if given["sourceColorSpace"] == "raw":
        codes, opaque = opaque_rgb(image)
        mean = (codes[opaque] if opaque.any() else codes.reshape(-1, 3)).mean(axis=0) / 255
    else:
        mean = np.array(colour_of((1, 1, 1), image))
    scale, bias = (np.array(given[k] or usual)[:3] for k, usual in (("scale", [1] * 4), ("bias", [0] * 4)))
    values = scale * mean + bias
    return colour_of(values if output == "rgb" else np.repeat(values["rgb".index(output)], 3))


def _coordinates(reader: Any, time: Any) -> str | None:
    """The name of the texture coordinates at which a UsdUVTexture is read, "" if it says none; None where they are moved."""
    UsdShade = pxr("UsdShade")
    given = reader.GetInput("st")
    sources = UsdShade.Utils.GetValueProducingAttributes(given) if given else []
    if not sources:
        return ""
    before = UsdShade.Shader(sources[0].GetPrim())
    if not str(before.GetIdAttr().Get()).startswith("UsdPrimvarReader"):
        return None
    name = before.GetInput("varname")
    named = UsdShade.Utils.GetValueProducingAttributes(name) if name else []
    return str(named[0].Get(time)) if named else ""


def _display_colour(prim: Any, time: Any) -> Colour | None:
    """The mean of a prim's displayColor."""
    values = pxr("UsdGeom").Gprim(prim).GetDisplayColorAttr().Get(time)
    return None if not values else colour_of(np.array(values, np.float64).mean(axis=0))


def _mesh(prim: Any, time: Any) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], Int[np.ndarray, "M"]]:
    """Points, triangles and corner UVs of a Mesh, and the polygon of each triangle. Raises ValueError if they do not fit each
    other."""
    UsdGeom = pxr("UsdGeom")
    mesh = UsdGeom.Mesh(prim)
    points = _array(mesh.GetPointsAttr(), time, 3)
    counts = _array(mesh.GetFaceVertexCountsAttr(), time).astype(np.int64)
    corners = _array(mesh.GetFaceVertexIndicesAttr(), time).astype(np.int64)
    holes = _array(mesh.GetHoleIndicesAttr(), time).astype(np.int64)
    if (counts < 0).any() or counts.sum() != len(corners):
        raise ValueError(f"{prim.GetPath()} has {len(corners)} corners for faces of {counts.sum()}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise ValueError(f"{prim.GetPath()} refers to points that it does not have")
    uv = _uv(prim, time, corners)
    fan, polygon = _fans(counts, holes[(holes >= 0) & (holes < len(counts))])
    if mesh.GetOrientationAttr().Get(time) == UsdGeom.Tokens.leftHanded:
        fan = fan[:, ::-1]
    return (points, corners[fan], uv[fan]), polygon


def _array(attribute: Any, time: Any, *width: int) -> np.ndarray:
    value = attribute.Get(time)
    return np.zeros((0, *width)) if value is None else np.array(value, np.float64).reshape(-1, *width)


def _uv_sets(prim: Any) -> list[Any]:
    """Primvars that may be texture coordinates, those that are read first."""
    known = [x for x in pxr("UsdGeom").PrimvarsAPI(prim).FindPrimvarsWithInheritance() if x.HasValue()]
    named = [x for x in known if x.GetPrimvarName() == "st"]  # of any type: some write float2[]
    return [*named, *(x for x in known if str(x.GetTypeName()).startswith("texCoord2") and x not in named)]


def _uv(prim: Any, time: Any, corners: np.ndarray) -> Float[np.ndarray, "_ 2"]:
    """Of each corner, NaN without any."""
    UsdGeom = pxr("UsdGeom")
    for primvar in _uv_sets(prim):
        values = np.array(primvar.ComputeFlattened(time), np.float64)
        if values.ndim == 2 and values.shape[1] == 2:
            if primvar.GetInterpolation() == UsdGeom.Tokens.faceVarying and len(values) == len(corners):
                return values
            of_points = primvar.GetInterpolation() in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)
            if of_points and len(values) > corners.max(initial=-1):
                return values[corners]
    return np.full((len(corners), 2), np.nan)


def _fans(counts: np.ndarray, holes: np.ndarray) -> tuple[Int[np.ndarray, "M 3"], Int[np.ndarray, "M"]]:
    """Triangles of polygons of so many corners each, as numbers of corners, and the polygon of each; none of holes."""
    triangles = np.maximum(counts - 2, 0)
    triangles[holes] = 0
    first = np.repeat(np.cumsum(counts) - counts, triangles)
    k = np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([first, first + k + 1, first + k + 2], axis=1), np.repeat(np.arange(len(counts)), triangles)


def _placed(
    mesh: tuple[np.ndarray, np.ndarray, np.ndarray], to_world: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points, faces, uv = mesh
    if not np.isfinite(to_world).all():
        raise ValueError("a transform is not finite")
    if np.linalg.det(to_world[:3, :3]) < 0:
        faces, uv = faces[:, ::-1], uv[:, ::-1]
    return points @ to_world[:3, :3].T + to_world[:3, 3], faces, uv
