"""Wind: gusts that move over a surface and comb what stands on it, for materials that have a lean.

Notation
ω           unit vector that the wind blows toward, world
x           point of the surface, world; P_u, P_v tangents along u and v, unit
strength    0 to 1: the lean, in parts of its range, where the wind blows along the surface and no gust adds to it
size        of the scene: the diagonal of its bounding box, world
g(x, t)     gusts, of mean 0 and variance 1: √(2/K) Σ a_j cos(2π κ_j·(x − t speed ω) / size + φ_j), waves that travel with
            the wind (Taylor's frozen turbulence); κ_j, a_j, φ_j drawn by the seed

Where the surface faces the wind, or away from it, what is along it of ω is short, and so is the lean. Phases of the generator
stay as they are, so the same blades stand in each frame and lean otherwise.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from mesoshell.errors import Argument, InputError
from mesoshell.film.motion import Motion
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.surface import KIND
from mesoshell.scene.growth import meshes_of
from mesoshell.scene.kept_meshes import mesh_of
from mesoshell.scene.scene import Grown, Scene
from mesoshell.scene.setup import box_of

LEAN, ANGLE = "lean", "lean_angle"
#: Pixels along a side of the images of lean and angle over the UV square.
SIDE = 96
#: Waves of the gusts, and their least and greatest number over the scene.
WAVES, MIN_WAVE_NUMBER, MAX_WAVE_NUMBER = 32, 1.0, 5.0
#: Share of the lean that gusts add or take, deviation of the wind's direction (radians), and sizes of the scene a second at
#: full strength.
GUST, VEER, SPEED = 0.45, 0.35, 0.8


@dataclass(frozen=True, eq=False)
class Ground:
    """Points and tangents of a surface under the pixels of an image over the UV square, v downward; world."""

    x: Float[np.ndarray, "H W 3"]
    along_u: Float[np.ndarray, "H W 3"]
    along_v: Float[np.ndarray, "H W 3"]


def add_wind(motion: Motion, scene: Scene, toward: Float[np.ndarray, "3"], strength: float, fps: float) -> Motion:
    """The motion of a settled scene with wind. It blows over all materials whose generator has a lean, but for further ones
    whose lean is given. toward: ω. Raises InputError if there is none, or for a strength out of range."""
    if not 0 < fps < np.inf:
        raise InputError(Argument("fps"), f"must be positive and finite, not {fps:g}")
    if not 0 < strength <= 1:
        raise InputError(Argument("wind"), f"must be above 0, to 1, not {strength:g}")
    parts = {k: part for k, part in enumerate((scene, *scene.also)) if _leans(part)}
    if not parts:
        names = dict.fromkeys(part.material.name for part in (scene, *scene.also))
        raise InputError(
            Argument("wind"),
            f"{' and '.join(names)} {'has' if len(names) == 1 else 'have'} no lean that wind could change (carpet has)",
        )
    first = motion.change(0)
    given = {k: sorted({LEAN, ANGLE} & {*part.params, *_own(first, k).get("params", {})}) for k, part in parts.items()}
    free = [k for k in parts if not given[k]]
    if given.get(0) or not free:  # further ones that are combed stay so
        k = next(k for k in parts if given[k])
        name = given[k][0] if k == 0 else f"{scene.also[k - 1].called}:{given[k][0]}"
        raise InputError(Argument("wind"), f"sets {name}, which is given too: leave one out")
    grounds = {k: ground_of(mesh_of(part.mesh)) for k in free if (part := parts[k]).mesh is not None}
    size = float(np.linalg.norm(np.ptp(box_of(meshes_of(scene)).astype(np.float64), axis=0)))

    def change(k: int) -> dict[str, Any]:
        moved = motion.change(k)
        for part, ground in grounds.items():
            own = _own(moved, part)
            lean, angle = wind_lean(ground, toward, strength, size, k / fps, scene.seed or 0)
            own = own | {"params": {**own.get("params", {}), LEAN: lean, ANGLE: angle}}
            moved = own if part == 0 else moved | {"also": {**moved.get("also", {}), part - 1: own}}
        return moved

    return Motion(motion.count, change, {*motion.shape, *grounds})


def _leans(part: Scene | Grown) -> bool:
    """Whether its texture can be grown with another lean."""
    if part.material.kind == KIND or part.material.shell.generator is None:
        return False
    return {LEAN, ANGLE} <= {name for name, p in part.material.parameters.items() if p.role == "beta"}


def _own(change: dict[str, Any], part: int) -> dict[str, Any]:
    """What changes of a material: 0 is the scene's own, 1 and on are those of `also`."""
    return change if part == 0 else change.get("also", {}).get(part - 1, {})


def wind_lean(
    ground: Ground, toward: Float[np.ndarray, "3"], strength: float, size: float, t: float, seed: int
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Lean and its angle from u toward v, both over their range, at time t in seconds."""
    at = (ground.x - t * SPEED * strength * size * toward) / size
    u, v = ground.along_u @ toward, ground.along_v @ toward
    lean = strength * np.hypot(u, v) * (1 + GUST * gusts(at, seed))
    angle = np.arctan2(v, u) + VEER * gusts(at, seed + 1)
    return np.clip(lean, 0, 1).astype(np.float32), (angle / (2 * np.pi) % 1.0).astype(np.float32)


def gusts(at: Float[np.ndarray, "*shape 3"], seed: int) -> Float[np.ndarray, "*shape"]:
    """g at points, in sizes of the scene."""
    random = np.random.default_rng([seed % 2**32, 0x57])
    way = random.normal(size=(WAVES, 3))
    number = MIN_WAVE_NUMBER * (MAX_WAVE_NUMBER / MIN_WAVE_NUMBER) ** random.random(WAVES)
    amplitude = number**-0.8
    amplitude /= np.sqrt((amplitude**2).mean())
    phase = 2 * np.pi * random.random(WAVES)
    waves = way / np.linalg.norm(way, axis=1, keepdims=True) * number[:, None]
    return (np.cos(2 * np.pi * at @ waves.T + phase) * amplitude).sum(axis=-1) * (2 / WAVES) ** 0.5


def ground_of(mesh: Mesh, side: int = SIDE) -> Ground:
    """The surface under the pixels of an image; pixels between charts take the nearest one's. Raises InputError if there
    are none."""
    uv = mesh.uv.astype(np.float64)
    uv = uv - np.floor(uv.mean(axis=1, keepdims=True))  # charts beyond the square repeat in it
    scene = EmbreeScene()
    flat = np.concatenate([uv, np.zeros((*uv.shape[:2], 1))], axis=-1)
    TriangleMesh(scene, np.ascontiguousarray(flat, np.float32))
    line = (np.arange(side) + 0.5) / side
    at = np.stack([*np.meshgrid(line, line[::-1]), np.ones((side, side))], axis=-1).reshape(-1, 3)
    down = np.broadcast_to(np.array([0, 0, -1], np.float32), at.shape)
    met: Any = scene.run(at.astype(np.float32), np.ascontiguousarray(down))
    face = met.reshape(side, side)
    if (face < 0).all():
        raise InputError(
            Argument("wind"), f"texture coordinates lie between the pixels of {side} x {side}: spread them out"
        )
    nearest = np.asarray(distance_transform_edt(face < 0, return_distances=False, return_indices=True))
    face = face[nearest[0], nearest[1]].ravel()
    corner, chart = mesh.vertices.astype(np.float64)[mesh.faces[face]], uv[face]
    along = np.linalg.pinv(chart[:, 1:] - chart[:, :1]) @ (corner[:, 1:] - corner[:, :1])  # ∂x/∂(u, v)
    tangents = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-300)
    offset = at[(nearest[0] * side + nearest[1]).ravel(), :2] - chart[:, 0]
    x = corner[:, 0] + np.einsum("pi,pij->pj", offset, along)
    shape = side, side, 3
    return Ground(x.reshape(shape), tangents[:, 0].reshape(shape), tangents[:, 1].reshape(shape))
