"""From a mesh to a shell of prisms, one on each triangle (MesoGAN §4.2 and appendix A; Porumbescu et al. 2005, shell maps).

Notation
λ_i, h          barycentric coordinates and relative height of a point in a prism, h in [0, 1]
b_i, o_i        base and offset of corner i, world: P(λ, h) = Σ λ_i (b_i + h o_i);  o = thickness × vertex normal
E_j, D_j        edges b_j − b_0 and o_j − o_0, j = 1, 2
g_i(h)          (E₁ + h D₁) × (E₂ + h D₂) · o_i
patch           what one training image shows; the unit of texture coordinates in a shell
scale           world length of a patch, averaged over the surface

det ∂P/∂(λ₁, λ₂, h) = Σ λ_i g_i(h): linear in λ, so a prism is free of folds just when all three g_i are positive on
[0, 1]. Each is a quadratic in h. Scaling a prism's offsets by s turns g_i(h) into s g_i(s h), so the first root x of
g_i(h) = ε |E₁ × E₂| |o_i| is the greatest such s: exact, and both test (x < 1: folded) and remedy. A folded prism's
vertices are lowered to x times the greatest thickness among them (what is below stays); this tilts its neighbours, so
the test is repeated wherever something moved.

Surfaces that touch at a vertex, or along an edge of more than two faces, have posts of their own there: one average of
their normals would lie below some of their faces. A prism free of folds can still meet another one elsewhere (thick fur
in a narrow crease): rays take the first. Float64 inside, on the float32 offsets that come out.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.errors import Argument, InputError
from mesoshell.geometry.mesh import Mesh, bounding_box, count_of, uv_stretch
from mesoshell.geometry.normals import vertex_normals
from mesoshell.geometry.topology import pair_edges, split_fans

#: Albedo of bare earth, linear Rec. 709: the default under a shell.
EARTH = (0.09, 0.06, 0.035)
#: Triangles of a tetrahedron, by corners: what a bilinear side of a shell lies in.
TETRAHEDRON = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])

#: ε: a prism's cross-section, seen along its corner posts, keeps this share of its base. Below, float32 loses J.
MIN_AREA = 1e-2
#: Least cosine between posts and normal of a face that can be extruded: twice ε, so that a small enough thickness exists.
MIN_COSINE = 2 * MIN_AREA
#: A round shrinks at least by this factor, so that the rounds end where neighbours tilt one another.
MIN_SHRINK = 0.95
ROUNDS = 256
#: The way of light out of a shell is computed as if the shell were flat: (1 − h) / cosine. The cosine is at least this. Flatter
#: light would go far along a flat shell; a real one curves away before that, and objects near it would be skipped.
FLATTEST = 0.25
#: A relative change of the patch's size above this is noted.
SAID_CHANGE = 0.05
#: Thickness over the diagonal of the mesh's bounding box, where neither thickness nor scale is given.
SHARE = 1 / 25
#: Patches along the diagonal of the mesh's bounding box, at most: single precision resolves no finer texture.
MAX_PATCHES = 1e6


@dataclass(frozen=True)
class Shell:
    """P prisms over V vertices: the mesh's, then copies of those where surfaces touch that share no inner edge.

    `notes` has one line for each way in which the shell departs from the request.
    """

    base: Float[np.ndarray, "V 3"]  # float32
    offset: Float[np.ndarray, "V 3"]  # float32
    faces: Int[np.ndarray, "P 3"]  # int32, vertices of a prism
    uv: Float[np.ndarray, "P 3 2"]  # float32, patches
    neighbour: Int[np.ndarray, "P 3"]  # int32, prism across the edge from vertex k to k + 1; -1 at a border
    neighbour_edge: Int[np.ndarray, "P 3"]  # int32, which of its edges that is; -1 at a border
    mesh_face: Int[np.ndarray, "P"]  # int32, the mesh's face that a prism stands on
    notes: tuple[str, ...]


def proportions(mesh: Mesh, height: float, thickness: float | None, scale: float | None) -> tuple[float, float]:
    """Thickness and scale (world) of a material that is `height` patches high. A value that is not given follows from the
    other; if neither is, from the mesh's size. Raises InputError for a number that is not positive and finite."""
    for name, value in (("thickness", thickness), ("scale", scale)):
        if value is not None and not 0 < value < np.inf:
            raise InputError(Argument(name), f"must be positive and finite, not {value:g}")
    low, high = bounding_box(mesh).astype(np.float64)
    least = float(np.linalg.norm(high - low)) / MAX_PATCHES
    if scale is not None and scale < least:
        raise InputError(
            Argument("scale"),
            f"{scale:g} is too small for this mesh, which would span {MAX_PATCHES:g} patches or more",
        )
    if thickness is None:
        thickness = float(np.linalg.norm(high - low)) * SHARE if scale is None else scale * height
    if scale is None and thickness / height < least:
        raise InputError(Argument("thickness"), f"{thickness:g} makes patches too small for this mesh: give `scale`")
    return thickness, thickness / height if scale is None else scale


def extrude(
    mesh: Mesh,
    thickness: float | Float[np.ndarray, "V"],
    scale: float,
    bare: Bool[np.ndarray, "F"] | None = None,
) -> Shell:
    """Grow a shell of a thickness (world; one for all vertices or one each) with patches of a size (world). bare: faces that
    are to carry none.

    The thickness is reduced where the shell would fold, faces that cannot be extruded at all carry no prism, and patches are
    resized so that a whole number fits into a UV unit, if a unit holds any: a UV square that closes on itself then has no
    seam. Raises InputError for a thickness or scale that is not positive and finite.
    """
    wanted = _check_thickness(thickness, len(mesh.vertices))
    patches, notes = _patches(uv_stretch(mesh), scale)
    faces, base, direction, origin = _posts(mesh)
    wanted = wanted[origin]
    if len(origin) > len(mesh.vertices):
        touching = count_of(len(np.unique(origin[len(mesh.vertices) :])), "vertex", "vertices")
        notes.append(f"{touching} where several surfaces touch: each surface has its own posts there")
    chosen = np.ones(len(faces), bool) if bare is None else ~bare
    usable = _usable(base, direction, faces) & chosen
    grown = _unfold(base, direction, wanted, faces[usable])
    offset = (direction * grown[:, None]).astype(np.float32)
    usable[usable] = first_fold(base, offset.astype(np.float64), faces[usable]) >= 1
    if not usable.any():
        raise InputError(
            Argument("thickness"),
            "no face that is to grow can be extruded: vertex normals lie below all of them, or they have no area",
        )
    if (lost := chosen & ~usable).any():
        left = f"{lost.sum()} of {chosen.sum()} faces left out (first: face {np.argmax(lost)})"
        notes.append(f"{left}: they fold at any thickness, because a vertex normal lies below them")
    factor = (grown / wanted)[np.unique(faces[usable])]
    if (factor < 1).any():
        what = f"thickness reduced at {(factor < 1).sum()} of {len(base)} vertices, where the shell would fold"
        notes.append(f"{what} (least factor {factor.min():.2g})")
    faces = faces[usable].astype(np.int32)
    neighbour, neighbour_edge = _neighbours(faces)
    uv = (mesh.uv[usable].astype(np.float64) * patches).astype(np.float32)
    mesh_face = np.flatnonzero(usable).astype(np.int32)
    return Shell(mesh.vertices[origin], offset, faces, uv, neighbour, neighbour_edge, mesh_face, tuple(notes))


def patches_per_uv(mesh: Mesh, shell: Shell) -> float:
    """Texture patches along one UV unit, as extruded."""
    size = float(np.abs(mesh.uv[shell.mesh_face]).max())
    return float(np.abs(shell.uv).max()) / size if size > 0 else 1.0


def is_even(mesh: Mesh, shell: Shell) -> bool:
    """Whether the shell is as thick everywhere on the mesh: else light may leave it, and meet it again."""
    thickness = np.linalg.norm(shell.offset[shell.faces], axis=-1)
    return len(shell.faces) == len(mesh.faces) and bool(np.ptp(thickness) <= 1e-3 * thickness.max())


def transform_shell(shell: Shell, to_world: Float[np.ndarray, "4 4"]) -> Shell:
    """The shell under an affine map, posts included. A mirrored shell has its corners' order reversed."""
    linear = to_world[:3, :3]
    base = shell.base.astype(np.float64) @ linear.T + to_world[:3, 3]
    offset = shell.offset.astype(np.float64) @ linear.T
    moved = replace(shell, base=base.astype(np.float32), offset=offset.astype(np.float32))
    if np.linalg.det(linear) > 0:
        return moved
    edge = shell.neighbour_edge[:, ::-1]
    return replace(
        moved,
        faces=shell.faces[:, [0, 2, 1]],
        uv=shell.uv[:, [0, 2, 1]],
        neighbour=shell.neighbour[:, ::-1],
        neighbour_edge=np.where(edge < 0, edge, 2 - edge),
    )


def _posts(
    mesh: Mesh,
) -> tuple[Int[np.ndarray, "F 3"], Float[np.ndarray, "W 3"], Float[np.ndarray, "W 3"], Int[np.ndarray, "W"]]:
    """Faces, base points and unit directions with one post for each fan of faces, and each post's mesh vertex."""
    count = len(mesh.vertices)
    faces, copied = split_fans(mesh.faces, pair_edges(mesh.faces), count)
    origin = np.append(np.arange(count), copied)
    base, direction = mesh.vertices[origin].astype(np.float64), mesh.normals[origin].astype(np.float64)
    if len(copied):
        several = np.isin(origin, copied)
        direction[several] = vertex_normals(base, faces)[0][several]
    return faces, base, direction, origin


def first_fold(
    base: Float[np.ndarray, "V 3"], offset: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "P 3"]
) -> Float[np.ndarray, "P"]:
    """The factor on its offsets at which each prism folds, to within ε; infinite where it never does."""
    b, o = base[faces], offset[faces]
    E, D = b[:, 1:] - b[:, :1], o[:, 1:] - o[:, :1]
    flat = np.cross(E[:, 0], E[:, 1])
    tilt = np.cross(E[:, 0], D[:, 1]) + np.cross(D[:, 0], E[:, 1])
    twist = np.cross(D[:, 0], D[:, 1])
    constant, linear, quadratic = (np.einsum("pi,pki->pk", n, o) for n in (flat, tilt, twist))
    constant -= MIN_AREA * np.linalg.norm(flat, axis=1)[:, None] * np.linalg.norm(o, axis=-1)
    return _least_root(constant, linear, quadratic).min(axis=1, initial=np.inf)


def _least_root(
    c: Float[np.ndarray, "P 3"], b: Float[np.ndarray, "P 3"], a: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, "P 3"]:
    """Least positive root of a x² + b x + c with c > 0, infinite where none; 0 where c ≤ 0.

    2c / (√(b² − 4ac) − b): the quotient form is exact for small a and picks the nearer of two positive roots.
    """
    discriminant = b * b - 4 * a * c
    below = np.sqrt(np.maximum(discriminant, 0)) - b
    root = np.full(c.shape, np.inf)
    np.divide(2 * c, below, out=root, where=(discriminant >= 0) & (below > 0))
    return np.where(c > 0, root, 0.0)


def _usable(
    base: Float[np.ndarray, "V 3"], direction: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Bool[np.ndarray, "F"]:
    corner = base[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    lean = np.einsum("fi,fki->fk", normal, direction[faces])
    size = np.linalg.norm(normal, axis=1)
    return (lean >= MIN_COSINE * size[:, None]).all(axis=1) & (size > 0)


def _unfold(
    base: Float[np.ndarray, "V 3"],
    direction: Float[np.ndarray, "V 3"],
    wanted: Float[np.ndarray, "V"],
    faces: Int[np.ndarray, "P 3"],
) -> Float[np.ndarray, "V"]:
    """The thickness at each vertex, at most the given one, at which no prism is folded."""
    thickness, suspect = wanted.copy(), faces
    for _ in range(ROUNDS):
        offset = (direction * thickness[:, None]).astype(np.float32).astype(np.float64)
        fold = first_fold(base, offset, suspect)
        folded = fold < 1
        if not folded.any():
            break
        ceiling = np.minimum(fold[folded], MIN_SHRINK) * thickness[suspect[folded]].max(axis=1)
        before = thickness.copy()
        np.minimum.at(thickness, suspect[folded], ceiling[:, None])
        suspect = faces[(thickness < before)[faces].any(axis=1)]
    return thickness


def _neighbours(faces: Int[np.ndarray, "P 3"]) -> tuple[Int[np.ndarray, "P 3"], Int[np.ndarray, "P 3"]]:
    edges = pair_edges(faces)
    prism, edge = edges.partner // 3, edges.partner % 3
    return np.where(edges.opposed, prism, -1).astype(np.int32), np.where(edges.opposed, edge, -1).astype(np.int32)


def _patches(stretch: float, scale: float) -> tuple[float, list[str]]:
    """Patches per UV unit, and a note if rounding changed their size."""
    if not 0 < scale < np.inf:
        raise InputError(Argument("scale"), f"must be positive and finite, not {scale:g}")
    exact = stretch / scale
    patches = float(np.round(exact)) if exact >= 1 else exact
    if abs(exact / patches - 1) <= SAID_CHANGE:
        return patches, []
    size = f"patches are {stretch / patches:.3g} wide, not {scale:.3g}"
    return patches, [f"{size}, so that a UV unit holds a whole number of them ({patches:.0f})"]


def _check_thickness(thickness: float | Float[np.ndarray, "V"], count: int) -> Float[np.ndarray, "V"]:
    given = np.asarray(thickness, np.float64)
    if given.ndim and given.shape != (count,):
        raise InputError(Argument("thickness"), f"has {given.size} values for {count} vertices")
    wanted = np.broadcast_to(given, (count,))
    wrong = np.flatnonzero(~((wanted > 0) & (wanted < np.inf)))
    if len(wrong):
        where = f" (vertex {wrong[0]})" if given.ndim else ""
        raise InputError(Argument("thickness"), f"must be positive and finite, not {wanted[wrong[0]]:g}{where}")
    return wanted
