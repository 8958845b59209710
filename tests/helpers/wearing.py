"""Surface materials, the answers that they should give, meshes and queries, small enough for several test files to make.

Notation
u, r, ω, ω′, κ   a query: places in periods (N, 2), footprints (N), directions (N, 3), curvature in 1 / period (N)
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.io.query_dataset import COLUMNS
from mesoshell.io.surface import MODULES, SurfaceBundle

SIZES: dict[str, Any] = {"texels": 8, "channels": 3, "hidden": (8,)}


def bundle(seed: int = 0, **more: Any) -> SurfaceBundle:
    """A random material of 8 texels, 3 channels and one hidden layer of 8, whose answers vary much; more: fields and sizes."""
    given = SIZES | more
    texels, channels, hidden = (given.pop(name) for name in ("texels", "channels", "hidden"))
    random, arrays = np.random.default_rng(seed), {}
    for module, (seen, out) in MODULES.items():
        for i in range(texels.bit_length()):
            arrays[f"{module}/texture/{i}"] = 2 * random.normal(size=(texels >> i, texels >> i, channels))
        widths = (channels + seen, *hidden)
        layers = {f"hidden/{i}": shape for i, shape in enumerate(zip(widths[:-1], hidden, strict=True))}
        for name, (wide, narrow) in (layers | {"last": (widths[-1], out)}).items():
            arrays[f"{module}/{name}/kernel"] = random.normal(size=(wide, narrow)) * (2 / wide) ** 0.5
            arrays[f"{module}/{name}/bias"] = 0.1 * random.normal(size=narrow)
    arrays = {k: x.astype(np.float16 if "/texture/" in k else np.float32) for k, x in arrays.items()}
    fields: dict[str, Any] = {"opacity": "direct", "step": 0.01, "offset": 0.1, "sees_curvature": True}
    fields |= {"curvature": (-1.0, 2.0), "depth": 0.125, "provenance": {}}
    return SurfaceBundle(texels=texels, channels=channels, arrays=arrays, **(fields | given))


def constant(alpha: float, rho: float | tuple[float, float, float], **more: Any) -> SurfaceBundle:
    """One opacity and one reflectance for all queries."""
    made = bundle(**more)
    for array in made.arrays.values():
        array[:] = 0
    logit = {0.0: -200.0, 1.0: 60.0}.get(alpha) or np.log(alpha / (1 - alpha))
    made.arrays["opacity/last/bias"][:] = logit
    made.arrays["reflectance/last/bias"][:] = 2 + np.log(np.expm1(rho))
    return made


def answers(b: SurfaceBundle, u, r, w, kappa, light) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """α, the silhouette cosine and ρ, in float64 from the description of the file alone (io/surface)."""
    u, r, w, kappa, light = (np.asarray(x, np.float64) for x in (u, r, w, kappa, light))
    low, high = b.curvature
    seen = (2 * np.clip(kappa, low, high) - low - high) / (high - low) * b.sees_curvature
    x = np.concatenate([w, seen[:, None]], axis=1)
    y = _network(b, "opacity", np.concatenate([texture(b, "opacity", u, r), x], axis=1))[:, 0]
    cosine = _sigmoid(y - 4) if b.opacity == "cosine" else np.zeros_like(y)
    alpha = {
        "direct": _sigmoid(y),
        "cosine": _sigmoid((w[:, 2] - cosine) / b.step),
        "none": np.ones_like(y),
    }[b.opacity]
    way = _network(b, "offset", np.concatenate([texture(b, "offset", u, r), x], axis=1))
    features = texture(b, "reflectance", u - b.offset * way * w[:, :2], r)
    rho = _network(b, "reflectance", np.concatenate([features, w, light, seen[:, None]], axis=1))
    return alpha, cosine, np.logaddexp(rho - 2, 0)


def texture(b: SurfaceBundle, module: str, u: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Features at places: bilinear on two levels, whose texels are as wide as ± one standard deviation, and linear between."""
    last = b.texels.bit_length() - 1
    level = np.log2(np.clip(2 * r * b.texels, 1, b.texels))
    lower = np.floor(level).astype(int)
    levels = np.stack([_bilinear(b.arrays[f"{module}/texture/{i}"].astype(np.float64), u) for i in range(last + 1)])
    rows = np.arange(len(u))
    share = (level - lower)[:, None]
    return (1 - share) * levels[lower, rows] + share * levels[np.minimum(lower + 1, last), rows]


def _bilinear(texels: np.ndarray, u: np.ndarray) -> np.ndarray:
    n = len(texels)
    x, y = (u * n - 0.5).T
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - i)[:, None], (y - j)[:, None]
    low, high = ((1 - fx) * texels[row % n, i % n] + fx * texels[row % n, (i + 1) % n] for row in (j, j + 1))
    return (1 - fy) * low + fy * high


def _network(b: SurfaceBundle, module: str, x: np.ndarray) -> np.ndarray:
    i = 0
    while f"{module}/hidden/{i}/kernel" in b.arrays:
        x = np.maximum(_layer(b, f"{module}/hidden/{i}", x), 0)
        i += 1
    return _layer(b, f"{module}/last", x)


def _layer(b: SurfaceBundle, name: str, x: np.ndarray) -> np.ndarray:
    return x @ b.arrays[f"{name}/kernel"].astype(np.float64) + b.arrays[f"{name}/bias"].astype(np.float64)


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return np.exp(-np.logaddexp(0, -x))


def directions(random: np.random.Generator, count: int) -> np.ndarray:
    """Unit vectors, evenly over the sphere."""
    x = random.normal(size=(count, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def queries(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Some of all kinds: places beyond the period, footprints from nothing to more than it, curvature beyond what is trained,
    light from all sides."""
    random = np.random.default_rng(seed)
    w = directions(random, count)
    w[:, 2] = np.maximum(np.abs(w[:, 2]), 1e-3)
    found = {
        "u": random.uniform(-2, 3, (count, 2)),
        "r": np.exp(random.uniform(-8, 2, count)) * (random.random(count) > 0.1),
        "w": w / np.linalg.norm(w, axis=1, keepdims=True),
        "kappa": random.uniform(-2, 3, count),
        "light": directions(random, count),
    }
    return {k: x.astype(np.float32) for k, x in found.items()}


def square() -> Mesh:
    """The unit square, seen from above; its chart is (x, y)."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return check_mesh(corners, faces, corners[faces][..., :2], "square")


def grid(point: Callable, columns: int, rows: int) -> Mesh:
    """A sheet of point(u, v) over the unit square, with v up it is seen from outside; its chart is (u, v)."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    k = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (x.ravel() for x in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    return check_mesh(np.stack(point(u.ravel(), v.ravel()), axis=-1), faces, uv[faces], "grid")


def ball(radius: float = 1.0, columns: int = 32, rows: int = 16) -> Mesh:
    """A sphere of longitudes and latitudes about the z axis."""

    def point(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
        around, up = 2 * np.pi * (u % 1), np.pi * v
        s = radius * np.sin(up) * (np.minimum(v, 1 - v) > 1e-9)
        return s * np.cos(around), s * np.sin(around), -radius * np.cos(up)

    return grid(point, columns, rows)


def tube(radius: float, height: float, columns: int = 32, rows: int = 16) -> Mesh:
    """A cylinder about the z axis, open at both ends; u goes around it and v up."""

    def point(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
        around = 2 * np.pi * (u % 1)
        return radius * np.cos(around), radius * np.sin(around), height * v

    return grid(point, columns, rows)


def lump() -> Mesh:
    """A closed surface of all curvatures that is not convex, about (½, ½, 0)."""

    def point(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
        around, up = 2 * np.pi * (u % 1), np.pi * v
        s = np.sin(up) * (np.minimum(v, 1 - v) > 1e-9)
        r = 0.6 + 0.3 * s**2 * np.cos(3 * around)
        return 0.5 + r * s * np.cos(around), 0.5 + r * s * np.sin(around), -r * np.cos(up)

    return grid(point, 18, 10)


def joined(*meshes: Mesh) -> Mesh:
    """One mesh of several."""
    first = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    points = np.concatenate([m.vertices for m in meshes]).astype(np.float64)
    faces = np.concatenate([m.faces + a for m, a in zip(meshes, first, strict=True)])
    return check_mesh(points, faces, np.concatenate([m.uv for m in meshes]), "several")


def moved(mesh: Mesh, *by: float) -> Mesh:
    return replace(mesh, vertices=(mesh.vertices + np.array(by)).astype(np.float32))


def turned(mesh: Mesh) -> Mesh:
    """Its other side out."""
    return check_mesh(mesh.vertices.astype(np.float64), mesh.faces[:, ::-1], mesh.uv[:, ::-1], "turned")


def write_obj(path: Path, mesh: Mesh) -> Path:
    """The mesh with its chart."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in mesh.uv.reshape(-1, 2)]
    corner = np.arange(3 * len(mesh.faces)).reshape(-1, 3) + 1
    lines += [
        "f " + " ".join(f"{a}/{b}" for a, b in zip(face, uv, strict=True))
        for face, uv in zip(mesh.faces + 1, corner, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def rows(count: int, seed: int, answer: Callable[[dict[str, np.ndarray]], dict[str, Any]]) -> np.ndarray:
    """A patch's rows with answers: alpha, cosine and rgb of its queries."""
    asked = queries(count, seed)
    asked |= {"u": asked["u"] % 1, "kappa": np.full(count, np.clip(asked["kappa"][0], -1, 2))}
    told = {name: np.asarray(x) for name, x in answer(asked).items()}
    parts = [asked["u"], asked["r"], asked["w"], asked["kappa"], asked["light"], told["alpha"], told["cosine"]]
    parts += [np.broadcast_to(told["rgb"], (count, 3)), np.full(count, seed)]
    table = [np.broadcast_to(x, (count,))[:, None] if x.ndim < 2 else x for x in map(np.asarray, parts)]
    found = np.concatenate(table, axis=1).astype(np.float32)
    assert found.shape == (count, len(COLUMNS))
    return found


def write_patches(folder: Path, patches: list[np.ndarray], **manifest: Any) -> Path:
    """A folder as `mesoshell dataset render-patches` makes it."""
    (folder / "patches").mkdir(parents=True)
    said = {"schema": 1, "kind": "patches", "source": "weave", "count": len(patches), "curvature": [-1.0, 2.0]}
    (folder / "manifest.json").write_text(json.dumps(said | {"depth": 0.125, "queries": len(patches[0])} | manifest))
    lines = []
    for index, patch in enumerate(patches):
        path = folder / f"patches/{index:06d}.npy"
        np.save(path, patch)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        row = {"index": index, "file": f"patches/{path.name}", "sha256": digest, "curvature": float(patch[0, 6])}
        lines.append(json.dumps(row) + "\n")
    (folder / "samples.jsonl").write_text("".join(lines))
    return folder
