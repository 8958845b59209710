"""Meshes of a USD stage to arrays, in world space (needs the extra `usd`: OpenUSD's own reader).

Notation
prim        of the stage, with a path such as /World/Hill; a Mesh has points, and polygons by their numbers of corners
interpolation   of texture coordinates: one a corner (faceVarying), or one a point (vertex, varying)

Read at the stage's first time code. What is invisible, or there for guidance or as a proxy, is left out; instances, and points
that repeat a prototype, are all there. A mesh that is to be subdivided is taken as its cage. Texture coordinates are `st`, or
the first of that type.

Sources: OpenUSD's documentation of UsdGeom: Mesh, Imageable, PointInstancer, Primvar.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from os import PathLike, fspath
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from mesoshell.errors import InputError
from mesoshell.limits import check_memory

FORMATS = (".usd", ".usda", ".usdc", ".usdz")
SEEN = ("default", "render")
Placed = tuple[list[str], tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"], Float[np.ndarray, "_ 3 2"]]]


def pxr(name: str) -> Any:
    """A module of OpenUSD's, which declare no types."""
    return import_module(f"pxr.{name}")


@contextmanager
def opened(path: str | PathLike[str]) -> Iterator[tuple[Any, Any]]:
    """The stage of a file, and its first time code. Raises InputError if it is not one, or OpenUSD is not installed."""
    try:
        Tf, Usd, UsdUtils = pxr("Tf"), pxr("Usd"), pxr("UsdUtils")
    except ModuleNotFoundError as fault:
        raise InputError(path, "is a USD stage, which requires usd-core: pip install mesoshell[usd]") from fault
    said = UsdUtils.CoalescingDiagnosticDelegate()  # what OpenUSD would print
    try:
        stage = Usd.Stage.Open(fspath(path))
        time = stage.GetStartTimeCode() if stage.HasAuthoredTimeCodeRange() else 0.0
        yield stage, Usd.TimeCode(time)
    except Tf.ErrorException as fault:
        raise InputError(path, "is no USD stage that can be read, or a damaged one") from fault
    finally:
        said.TakeUncoalescedDiagnostics()


def parts(path: str | PathLike[str]) -> Sequence[Placed]:
    """Each mesh of a stage, with the names of its prim and of those above it, from itself upward: paths, then bare names."""
    with opened(path) as (stage, time):
        Usd, UsdGeom = pxr("Usd"), pxr("UsdGeom")

        frames, found, instancers = UsdGeom.XformCache(time), [], []
        walk = iter(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
        for prim in walk:
            if prim.IsA(UsdGeom.PointInstancer):
                instancers.append(prim)
                walk.PruneChildren()  # prototypes below it stand nowhere themselves
            elif prim.IsA(UsdGeom.Mesh) and _seen(prim, time):
                found.append((_names(prim), _placed(_mesh(prim, time), frames.GetLocalToWorldTransform(prim))))
        for prim in instancers:
            if _seen(prim, time):
                found += _repeated(stage, prim, time, frames)
        return found


def is_visible(prim: Any, time: Any) -> bool:
    """Whether a prim and all above it are visible."""
    UsdGeom = pxr("UsdGeom")

    return UsdGeom.Imageable(prim).ComputeVisibility(time) != UsdGeom.Tokens.invisible


def matrix(usd: Any) -> Float[np.ndarray, "4 4"]:
    """A transform, of columns: OpenUSD's are of rows."""
    return np.array(usd, np.float64).reshape(4, 4).T


def _seen(prim: Any, time: Any) -> bool:
    UsdGeom = pxr("UsdGeom")

    return is_visible(prim, time) and UsdGeom.Imageable(prim).ComputePurpose() in SEEN


def _names(prim: Any) -> list[str]:
    above = []
    while not prim.IsPseudoRoot():
        above.append(prim)
        prim = prim.GetParent()
    return [name for x in above for name in (str(x.GetPath()), x.GetName())]


def _mesh(prim: Any, time: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, triangles and corner UVs of a Mesh. Raises ValueError if they do not fit each other."""
    UsdGeom = pxr("UsdGeom")

    mesh = UsdGeom.Mesh(prim)
    points = _array(mesh.GetPointsAttr(), time, 3)
    counts = _array(mesh.GetFaceVertexCountsAttr(), time).astype(np.int64)
    corners = _array(mesh.GetFaceVertexIndicesAttr(), time).astype(np.int64)
    if (counts < 0).any() or counts.sum() != len(corners):
        raise ValueError(f"{prim.GetPath()} has {len(corners)} corners for faces of {counts.sum()}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise ValueError(f"{prim.GetPath()} refers to points that it does not have")
    uv = _uv(prim, time, corners)
    fan = _fans(counts)
    if mesh.GetOrientationAttr().Get(time) == UsdGeom.Tokens.leftHanded:
        fan = fan[:, ::-1]
    return points, corners[fan], uv[fan]


def _array(attribute: Any, time: Any, *width: int) -> np.ndarray:
    value = attribute.Get(time)
    return np.zeros((0, *width)) if value is None else np.array(value, np.float64).reshape(-1, *width)


def _uv(prim: Any, time: Any, corners: np.ndarray) -> Float[np.ndarray, "_ 2"]:
    """Of each corner, NaN without any."""
    UsdGeom = pxr("UsdGeom")

    primvars = UsdGeom.PrimvarsAPI(prim)
    known = [x for x in primvars.FindPrimvarsWithInheritance() if str(x.GetTypeName()).startswith("texCoord2")]
    known.sort(key=lambda x: x.GetPrimvarName() != "st")
    plain = primvars.FindPrimvarWithInheritance("st")
    if not known and plain and plain.HasValue():
        known = [plain]  # as float2[]
    for primvar in known:
        values = np.array(primvar.ComputeFlattened(time), np.float64)
        if values.ndim == 2 and values.shape[1] == 2:
            if primvar.GetInterpolation() == UsdGeom.Tokens.faceVarying and len(values) == len(corners):
                return values
            of_points = primvar.GetInterpolation() in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)
            if of_points and len(values) > corners.max(initial=-1):
                return values[corners]
    return np.full((len(corners), 2), np.nan)


def _fans(counts: np.ndarray) -> Int[np.ndarray, "_ 3"]:
    """Triangles of polygons of so many corners each, as numbers of corners."""
    triangles = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, triangles)
    k = np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([first, first + k + 1, first + k + 2], axis=1)


def _placed(
    mesh: tuple[np.ndarray, np.ndarray, np.ndarray], to_world: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points, faces, uv = mesh
    m = to_world if isinstance(to_world, np.ndarray) else matrix(to_world)
    if np.linalg.det(m[:3, :3]) < 0:
        faces, uv = faces[:, ::-1], uv[:, ::-1]
    return points @ m[:3, :3].T + m[:3, 3], faces, uv


def _repeated(stage: Any, prim: Any, time: Any, frames: Any) -> Iterator[Placed]:
    """The meshes of a PointInstancer's prototypes, once for each of its points."""
    Usd, UsdGeom = pxr("Usd"), pxr("UsdGeom")

    instancer = UsdGeom.PointInstancer(prim)
    which = _array(instancer.GetProtoIndicesAttr(), time).astype(int)
    places = instancer.ComputeInstanceTransformsAtTime(time, time, UsdGeom.PointInstancer.ExcludeProtoXform)
    mask = instancer.ComputeMaskAtTime(time)
    if mask:
        which = which[np.array(mask, bool)]
    base = matrix(frames.GetLocalToWorldTransform(prim))
    for k, path in enumerate(instancer.GetPrototypesRel().GetForwardedTargets()):
        root = stage.GetPrimAtPath(path)
        own = [base @ matrix(place) for place, of in zip(places, which, strict=True) if of == k]
        for part in Usd.PrimRange(root, Usd.TraverseInstanceProxies()) if root else ():
            if part.IsA(UsdGeom.Mesh) and _seen(part, time):
                mesh = _mesh(part, time)
                check_memory(
                    str(prim.GetPath()), f"{len(own)} copies of {part.GetPath()}", 200 * len(own) * len(mesh[1])
                )
                within = np.linalg.inv(matrix(frames.GetLocalToWorldTransform(root.GetParent())))
                local = within @ matrix(frames.GetLocalToWorldTransform(part))
                yield from ((_names(prim), _placed(mesh, place @ local)) for place in own)
