"""Scores of a material's texture over a flat field: does it repeat, does it copy exemplars, does it follow a comb?

Notation
repeat       largest autocorrelation, at lags of a patch or more, of a picture from above
D            distance of a patch from its nearest exemplar at any shift (measure/copies)
comb         a field of the parameter `lean_angle` that turns once about its middle, and the pile's direction at 16 places

Parameters have their defaults. A fitted patch repeats by construction, and its D from itself is 0.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.io.bundle import Bundle
from mesoshell.io.corner_tiles import seed_origin
from mesoshell.io.material import parameter_vector
from mesoshell.io.sheet import tile_pictures
from mesoshell.measure import above
from mesoshell.measure.copies import Nearest, layer_means, nearest
from mesoshell.measure.direction import leans, mean_error, strokes
from mesoshell.measure.repetition import largest_repeat
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle
from mesoshell.shell.material.loader import DeviceMaterial, load_device_material

#: Patches along a field, pixels a patch, layers; light of its picture.
FIELD, LAYERS, ASLANT = (12, 24), 32, (0.6, 0.0, 0.8)
#: For comparison with exemplars: pixels and layers of a patch, patches along a texture, textures.
PATCH, TIERS, SIDE, SEEDS = 64, 12, 4, 4
#: Patches along a combed field, pixels a patch and layers, places along it; pixels a patch and layers of its picture. With
#: 24 pixels, strokes of fitted carpets that lean are 11 degrees off on the mean, with 64 pixels 3.
COMBED, FINE, PLACES, PICTURE = 8, 24, 4, (64, 48)
COMB = "lean_angle"
#: Patches that are shown beside their nearest exemplars.
SHOWN = 12


class Combed(NamedTuple):
    """Mean error of the lean in the volume, modulo a turn, and of strokes in a picture, modulo half a turn: degrees."""

    lean: float
    strokes: float


def score(
    bundle: Bundle, name: str, exemplars: Float[np.ndarray, "E K V U"] | None
) -> tuple[dict[str, dict[str, float]], dict[str, Float[np.ndarray, "_h _w 3"]]]:
    """Scores of a texture, each with its `value` and perhaps a range, `low` to `high`; and pictures: `field`, from above, and
    `nearest`, patches beside their nearest exemplars. Both are empty for a generator of three planes: it makes no texture."""
    if bundle.generator is not None and bundle.generator.get("planes", 1) > 1:
        return {}, {}
    pictures = {"field": seen_from_above(bundle, name)}
    scores = {"repeat": {"value": repeat(pictures["field"])}}
    if exemplars is not None:
        made = patches(bundle, name)
        matches = nearest_exemplars(made, exemplars)
        scores |= distances(matches)
        theirs = [np.roll(exemplars[row.exemplar], np.negative(row.shift), (1, 2)) for row in matches]
        pairs = [_height(x) for pair in zip(made[:SHOWN], theirs, strict=False) for x in pair]
        pictures["nearest"] = tile_pictures(np.stack(pairs), 8)
    if combs(bundle):
        off = combing_error(bundle, name)
        scores |= {"comb, lean": {"value": off.lean}, "comb, strokes": {"value": off.strokes}}
    return scores, pictures


def distances(matches: Sequence[Nearest]) -> dict[str, dict[str, float]]:
    """The median distance from the nearest exemplar, with the least and the greatest as its range."""
    d = [row.distance for row in matches]
    return {"nearest exemplar": {"value": float(np.median(d)), "low": min(d), "high": max(d)}}


def seen_from_above(bundle: Bundle, name: str) -> Float[np.ndarray, "V U 3"]:
    """A picture of a field, x/(1 + x)."""
    loaded, alpha = _grown(bundle, name, FIELD[0], TextureRequest())
    return above.picture(loaded, alpha, FIELD, ASLANT, LAYERS)


def repeat(field: Float[np.ndarray, "V U 3"]) -> float:
    """The largest autocorrelation of such a picture."""
    return largest_repeat(field, FIELD[1])[0]


def patches(bundle: Bundle, name: str) -> Float[np.ndarray, "M K V U"]:
    """Opacities of a fitted patch, or of SEEDS × SIDE² patches of a generator or of corner tiles."""
    if bundle.generator is None and bundle.tiles is None:
        loaded, alpha = _grown(bundle, name, 1, TextureRequest())
        return above.opacities(loaded, alpha, (1, PATCH), TIERS)[None]
    parts = []
    for seed in range(SEEDS):
        loaded, alpha = _grown(bundle, name, SIDE, TextureRequest(seed))
        wide = above.opacities(loaded, alpha, (SIDE, PATCH), TIERS)
        cut = wide.reshape(TIERS, SIDE, PATCH, SIDE, PATCH)
        parts.append(cut.transpose(1, 3, 0, 2, 4).reshape(SIDE**2, TIERS, PATCH, PATCH))
    return np.concatenate(parts)


def nearest_exemplars(made: Float[np.ndarray, "M K V U"], exemplars: Float[np.ndarray, "E K V U"]) -> list[Nearest]:
    """The nearest exemplar of each patch."""
    mean = layer_means(exemplars)
    return [nearest(x.astype(np.float64), exemplars, mean) for x in made]


def combs(bundle: Bundle) -> bool:
    """Whether the material has a generator with a geometry parameter COMB."""
    return bundle.generator is not None and any(p.name == COMB and p.role == "beta" for p in bundle.parameters)


def combing_error(bundle: Bundle, name: str) -> Combed:
    """How well the pile follows a field of angles."""
    low, high = next(p.range for p in bundle.parameters if p.name == COMB)

    def angle(at: np.ndarray) -> np.ndarray:
        u, v = np.moveaxis(at - COMBED / 2, -1, 0)
        return np.arctan2(v, u) % (2 * math.pi)

    def value(at: np.ndarray) -> np.ndarray:
        return np.clip((angle(at) - low) / (high - low), 0, 1)

    loaded, alpha = _grown(bundle, name, COMBED, TextureRequest(fields={COMB: value}))
    field, middles = (COMBED, FINE), (np.arange(PLACES) + 0.5) * COMBED / PLACES
    wanted = angle(np.stack(np.meshgrid(middles, middles), axis=-1))
    volume = above.opacities(loaded, alpha, field, FINE)
    lean = leans(volume, (1 / FINE, 1 / FINE), (PLACES, PLACES))[0]
    picture = above.picture(loaded, alpha, (COMBED, PICTURE[0]), (0.0, 0.0, 1.0), PICTURE[1]).mean(axis=-1)
    stroke = strokes(picture, (PLACES, PLACES))[0]
    return Combed(
        math.degrees(mean_error(lean, wanted, 2 * math.pi)), math.degrees(mean_error(stroke, wanted, math.pi))
    )


def _height(opacity: Float[np.ndarray, "K V U"]) -> Float[np.ndarray, "V U 3"]:
    """Mean height of the first thing met from above, as grey."""
    clear = np.cumprod(1 - opacity[::-1], axis=0)
    weight = np.concatenate([np.ones_like(clear[:1]), clear[:-1]]) * opacity[::-1]
    height = (np.arange(len(opacity))[::-1, None, None] + 0.5) / len(opacity)
    return np.repeat((weight * height).sum(axis=0)[..., None], 3, axis=2).astype(np.float32)


def _grown(
    bundle: Bundle, name: str, side: int, wanted: TextureRequest
) -> tuple[DeviceMaterial, Float[np.ndarray, "A"]]:
    """The material over `side` × `side` patches, and α."""
    if bundle.generator is not None:
        texels = round(side * bundle.texel_density)
        bundle = bake_bundle(bundle, name, (texels, texels), wanted)[0]
    origin = (0, 0) if bundle.tiles is None else seed_origin(wanted.seed)
    return load_device_material(bundle, origin), parameter_vector(bundle, {})
