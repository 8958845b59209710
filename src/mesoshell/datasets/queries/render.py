"""A dataset of queries: patches of cylinders of random curvature, turned and shifted on the texture.

Notation
κ            curvature, uniform in a range of both signs; every eighth patch is flat
place        in the middle of the patch, one period wide
ω            across the cylinder's axis, from either side; one in four is GRAZING
ω′           one in four below the horizon
radius       a share of them at the settings' narrowest, the others up to the widest, uniform in the logarithm

A patch depends on the settings and its number alone. A run that was interrupted goes on where it stopped.
"""

import hashlib
import io
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell.datasets.queries.tile import PatchPlacement, Tile
from mesoshell.errors import Argument, InputError
from mesoshell.io.atomic import replace_file
from mesoshell.io.dataset_writer import collecting
from mesoshell.io.query_dataset import COLUMNS, PARTS

VERSION = 2
#: The least ω_z, and the greatest of grazing rays.
MIN_COSINE, GRAZING = 0.03, 0.35
#: The narrowest radius, and the widest for geometry, which extends over REACH; periods.
FINEST, WIDEST = 1 / 512, 1 / 4
#: How far the mesostructure extends from the middle, across the axis and along it, periods.
REACH = (2.5, 2.0)


#: From how a patch lies, queries of it (columns, as in trace.queries) and a seed: columns of answers, and seconds by stage.
Answers = Callable[[PatchPlacement, dict[str, np.ndarray], int], tuple[dict[str, np.ndarray], dict[str, float]]]


@dataclass(frozen=True)
class Settings:
    """The settings that two runs must share to write one dataset. source: a procedure, an image's file, or a material with its
    digest, parameters and base; depth: periods; curvature: least and greatest, 1 / period; narrowest, widest: radii, periods;
    finest: share of queries at the narrowest."""

    source: str
    depth: float
    curvature: tuple[float, float]
    queries: int
    spp: int
    seed: int
    narrowest: float = FINEST
    widest: float = WIDEST
    finest: float = 0.5


def of_geometry(tile: Tile, spp: int) -> Answers:
    """Answers of a mesostructure, by tracing light through it. Loads Mitsuba."""
    from mesoshell.datasets.queries.trace import Patch, queries

    def answers(placing: PatchPlacement, query: dict[str, np.ndarray], seed: int):
        begin = time.perf_counter()
        patch = Patch(tile, placing, REACH)
        built = time.perf_counter()
        answer = queries(patch, placing, query, spp, seed)
        return answer, {"geometry": built - begin, "light": time.perf_counter() - built}

    return answers


def render_patches(
    settings: Settings, answers: Answers, count: int, folder: Path, show: Callable[[int, int], None]
) -> dict[str, float]:
    """Write the missing ones of patches 0 … count − 1 into the folder. show: called with (finished, missing). Returns seconds
    by stage, and how many patches are new. Raises InputError."""
    check_curvature(settings.curvature, settings.depth)
    manifest = {"schema": 1, "kind": PARTS, "version": VERSION} | asdict(settings)
    if Path(settings.source).is_file():
        manifest["source_sha256"] = hashlib.sha256(Path(settings.source).read_bytes()).hexdigest()
    spent = {"geometry": 0.0, "light": 0.0, "new": 0}
    with collecting(folder, manifest, count, PARTS) as collector:
        missing = collector.missing(count)
        show(0, len(missing))
        for done, index in enumerate(missing, start=1):
            rows, seconds = sample(settings, answers, index)
            file = f"{PARTS}/{index:06d}.npy"
            data = io.BytesIO()
            np.save(data, rows)
            replace_file(folder / file, data.getvalue())
            digest = hashlib.sha256(data.getvalue()).hexdigest()
            row = {"index": index, "file": file, "sha256": digest, "curvature": float(rows[0, COLUMNS.index("kappa")])}
            collector.add(row, {"index": index, "seconds": seconds})
            spent = {k: spent[k] + seconds.get(k, 1) for k in spent}
            show(done, len(missing))
        collector.sort()
    return spent


def check_curvature(curvature: tuple[float, float], depth: float) -> None:
    """Raises InputError unless a layer of this depth fits on all cylinders of this range."""
    low, high = curvature
    if not (np.isfinite(curvature).all() and low < high):
        raise InputError(Argument("curvature"), f"{low:g} to {high:g} is no range")
    if high * depth >= 0.95:
        raise InputError(
            Argument("curvature"),
            f"a layer {depth:g} deep does not fit under a surface of radius {1 / high:g}: at most {0.95 / depth:g}",
        )


def sample(settings: Settings, answers: Answers, index: int) -> tuple[np.ndarray, dict[str, float]]:
    """The queries of one patch with their answers (Q, 16), float32; and seconds."""
    random = np.random.default_rng([settings.seed, index])
    low, high = settings.curvature
    curvature = 0.0 if index % 8 == 7 else random.uniform(low, high)
    placing = PatchPlacement(curvature, random.uniform(0, 2 * np.pi), tuple(random.random(2)))
    query = questions(settings, random)
    answer, seconds = answers(placing, query, int(random.integers(2**31)))
    return rows_of(placing, query, answer, index), seconds


def rows_of(
    placing: PatchPlacement, query: dict[str, np.ndarray], answer: dict[str, np.ndarray], index: int
) -> Float[np.ndarray, "Q 16"]:
    """Queries and answers as a patch keeps them (io/query_dataset), float32."""
    uv = placing.texture(query["place"]) % 1.0
    toward, light = (_turned(query[name], placing.turn) for name in ("toward", "light"))
    kappa = np.full((len(uv), 1), placing.curvature)
    parts = [uv, query["radius"][:, None], toward, kappa, light]
    parts += [answer["alpha"], answer["cosine"], answer["reflectance"], np.full_like(kappa, index)]
    return np.concatenate(parts, axis=1).astype(np.float32)


def questions(settings: Settings, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Random queries of one patch, as columns (trace.queries)."""
    count, narrowest = settings.queries, settings.narrowest
    cosine = np.where(
        random.random(count) < 0.25, random.uniform(MIN_COSINE, GRAZING, count), random.uniform(MIN_COSINE, 1, count)
    )
    sine = np.sqrt(1 - cosine**2) * np.where(random.random(count) < 0.5, 1, -1)
    z = random.random(count) * np.where(random.random(count) < 0.25, -1, 1)
    angle, level = random.uniform(0, 2 * np.pi, count), np.sqrt(1 - z**2)
    wide = narrowest * (settings.widest / narrowest) ** random.random(count)
    return {
        "place": random.uniform(-0.5, 0.5, (count, 2)),
        "radius": np.where(random.random(count) < settings.finest, narrowest, wide),
        "toward": np.stack([sine, np.zeros(count), cosine], axis=-1),
        "light": np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=-1),
    }


def _turned(w: np.ndarray, angle: float) -> np.ndarray:
    """Directions in the patch's frame, turned into that of (u, v)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * w[:, 0] - s * w[:, 1], s * w[:, 0] + c * w[:, 1], w[:, 2]], axis=-1)
