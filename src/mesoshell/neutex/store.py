"""A captured object on disk: its networks, its box, and the poses of its photographs.

Notation
PATH.npz    arrays by their place in Field, slash-joined (sigma/hidden/0/kernel), and manifest.json; readable with NumPy alone
world       of the capture: x = centre + half · y
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.archive import MANIFEST, read_arrays, read_heads, write_arrays
from mesoshell.io.records import parse_json
from mesoshell.nets.encoding import HashConfig
from mesoshell.neutex.cameras import Photo
from mesoshell.neutex.field import Field, FieldConfig, init_field
from mesoshell.render.quality import PRESETS, Quality

SCHEMA = 1
#: Most samples a ray of a file.
MAX_SAMPLES = 4096


@dataclass(frozen=True)
class NeuTexModel:
    """photos: all views, at their size in training; tested: which of them were held out."""

    config: FieldConfig
    field: Field
    centre: Float[np.ndarray, "3"]
    half: float
    photos: tuple[Photo, ...]
    tested: tuple[int, ...]
    provenance: dict[str, Any]

    def quality(self, preset: str) -> Quality:
        """A preset with as many samples a ray as the object was learned with; `reference` has no fewer than its own."""
        quality = PRESETS[preset]
        learned = self.provenance.get("config", {}).get("samples", quality.samples)
        return quality.with_changes(samples=max(learned, quality.samples) if preset == "reference" else learned)

    def to_box(self, photo: Photo) -> Photo:
        """The same camera in the box's units."""
        m = photo.to_world.copy()
        m[:3, 3] = (m[:3, 3] - self.centre) / self.half
        return photo._replace(to_world=m)


def write_neutex(path: Path, captured: NeuTexModel) -> None:
    """Write the object. Raises InputError if the file cannot be written."""
    about = {
        "schema": SCHEMA,
        "kind": "captured object",
        "config": asdict(captured.config),
        "centre": captured.centre.tolist(),
        "half": captured.half,
        "photos": [{**p._asdict(), "to_world": p.to_world.tolist()} for p in captured.photos],
        "tested": captured.tested,
        "provenance": captured.provenance,
    }
    arrays = {MANIFEST: np.frombuffer(json.dumps(about).encode(), np.uint8)}
    write_arrays(path, arrays | {k: np.asarray(x, np.float32) for k, x in _named(captured.field).items()})


def read_neutex(path: Path) -> NeuTexModel:
    """Read an object. Raises InputError if the file is not one, or its contents do not match its manifest."""
    heads = read_heads(path)
    if MANIFEST not in heads:
        raise InputError(path, f"is not a captured object: it has no {MANIFEST}")
    try:
        about = parse_json(path, read_arrays(path, [MANIFEST])[MANIFEST].tobytes(), f"{MANIFEST} is ")
        if about["kind"] != "captured object" or about["schema"] != SCHEMA:
            raise InputError(
                path, f"is not a captured object of schema {SCHEMA}, but {about['kind']} of {about['schema']}"
            )
        config = _config(about["config"])
        template = jax.eval_shape(lambda: init_field(config, jax.random.key(0)))
        photos = tuple(_photo(p) for p in about["photos"])
        centre, half = np.array(about["centre"], np.float64).reshape(3), float(about["half"])
        tested, provenance = tuple(map(int, about["tested"])), dict(about["provenance"])
        if not (np.isfinite(centre).all() and 0 < half < np.inf and all(0 <= i < len(photos) for i in tested)):
            raise ValueError(f"its box is about {centre} with half a side of {half}, its held views are {tested}")
        if not photos or not all(map(_is_camera, photos)):
            raise ValueError("it has no photograph, or one whose camera is none")
        samples = provenance.get("config", {}).get("samples", 1)
        if not (type(samples) is int and 1 <= samples <= MAX_SAMPLES):
            raise ValueError(f"it was learned with {samples!r} samples a ray")
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, ZeroDivisionError) as error:
        raise InputError(path, f"is not a captured object: {error}") from None
    named = _named(template)
    for key, wanted in named.items():
        head = heads.get(key)
        if head is None or head[0] != wanted.shape or head[1] != np.float32:
            stored = f"{head[0]} of {head[1]}" if head else "missing"
            raise InputError(path, f"{key} is {stored}, not {wanted.shape} of float32")
    arrays = read_arrays(path, named)
    leaves = [jnp.asarray(arrays[key]) for key in named]
    if not all(np.isfinite(x).all() for x in leaves):
        raise InputError(path, "has weights that are not finite")
    field = jax.tree.unflatten(jax.tree.structure(template), leaves)
    return NeuTexModel(config, field, centre, half, photos, tested, provenance)


def _named(field: Field) -> dict[str, Any]:
    return {
        "/".join(str(getattr(k, "name", getattr(k, "idx", k))) for k in path): leaf
        for path, leaf in jax.tree_util.tree_leaves_with_path(field)
    }


def _config(entries: dict[str, Any]) -> FieldConfig:
    lists = {k: tuple(x) if isinstance(x, list) else x for k, x in entries.items()}
    return FieldConfig(**{**lists, "hash": HashConfig(**entries["hash"])})


def _is_camera(photo: Photo) -> bool:
    fx, fy = photo.lens[:2]
    known = np.isfinite(photo.to_world).all() and np.isfinite(photo.lens).all()
    return bool(known and min(fx, fy) > 0 and min(photo.width, photo.height) > 0)


def _photo(entries: dict[str, Any]) -> Photo:
    m = np.array(entries["to_world"], np.float64).reshape(4, 4)
    fx, fy, cx, cy = (float(x) for x in entries["lens"])
    return Photo(m, (fx, fy, cx, cy), int(entries["width"]), int(entries["height"]))
