"""Judgements of a material's texture over a flat field: does it repeat, does it copy, can it be combed? (floor 5)

Alphabet
repeat       largest autocorrelation, at lags of a patch or more, of a picture from above
D            distance of a patch from its nearest exemplar at any shift (measure/copies)
comb         a field of the parameter `lean_angle` that turns once about its middle, and the pile's direction at 16 places

Parameters have their defaults. A fitted patch repeats by construction, and its D from itself is 0.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.io.bundle import Bundle
from mesoshell.io.material import normalised
from mesoshell.measure import above
from mesoshell.measure.copies import Nearest, layer_means, nearest
from mesoshell.measure.direction import leans, mean_error, strokes
from mesoshell.measure.repetition import largest_repeat
from mesoshell.shell.grow import Wanted, baked
from mesoshell.shell.scene import Ready, ready

#: Patches along a field, pixels a patch, layers; light of its picture.
FIELD, LAYERS, ASLANT = (12, 24), 32, (0.6, 0.0, 0.8)
#: Of patches that are compared with exemplars: pixels and layers of each, patches along a texture, textures.
PATCH, TIERS, SIDE, SEEDS = 64, 12, 4, 4
#: Patches along a combed field, pixels a patch and layers, places along it.
COMBED, FINE, PLACES = 8, 24, 4
COMB = "lean_angle"


class Combed(NamedTuple):
    """Mean error of the lean in the volume, modulo a turn, and of strokes in a picture, modulo half a turn: degrees."""

    lean: float
    strokes: float


def seen_from_above(bundle: Bundle, name: str) -> Float[np.ndarray, "V U 3"]:
    """A picture of a field, x/(1 + x)."""
    found, alpha = _grown(bundle, name, FIELD[0], Wanted())
    return above.picture(found, alpha, FIELD, ASLANT, LAYERS)


def repeat(field: Float[np.ndarray, "V U 3"]) -> float:
    """Of such a picture."""
    return largest_repeat(field, FIELD[1])[0]


def patches(bundle: Bundle, name: str) -> Float[np.ndarray, "M K V U"]:
    """Opacities of a fitted patch, or of SEEDS × SIDE² patches of a generator."""
    if bundle.generator is None:
        found, alpha = _grown(bundle, name, 1, Wanted())
        return above.opacities(found, alpha, (1, PATCH), TIERS)[None]
    parts = []
    for seed in range(SEEDS):
        found, alpha = _grown(bundle, name, SIDE, Wanted(seed))
        wide = above.opacities(found, alpha, (SIDE, PATCH), TIERS)
        cut = wide.reshape(TIERS, SIDE, PATCH, SIDE, PATCH)
        parts.append(cut.transpose(1, 3, 0, 2, 4).reshape(SIDE**2, TIERS, PATCH, PATCH))
    return np.concatenate(parts)


def copied(made: Float[np.ndarray, "M K V U"], exemplars: Float[np.ndarray, "E K V U"]) -> list[Nearest]:
    """The nearest exemplar of each patch."""
    mean = layer_means(exemplars)
    return [nearest(x.astype(np.float64), exemplars, mean) for x in made]


def combs(bundle: Bundle) -> bool:
    """Whether there is something to comb."""
    return bundle.generator is not None and any(p.name == COMB and p.role == "beta" for p in bundle.parameters)


def combed(bundle: Bundle, name: str) -> Combed:
    """How well the pile follows a field of angles."""
    low, high = next(p.range for p in bundle.parameters if p.name == COMB)

    def angle(at: np.ndarray) -> np.ndarray:
        u, v = np.moveaxis(at - COMBED / 2, -1, 0)
        return np.arctan2(v, u) % (2 * math.pi)

    def value(at: np.ndarray) -> np.ndarray:
        return np.clip((angle(at) - low) / (high - low), 0, 1)

    found, alpha = _grown(bundle, name, COMBED, Wanted(fields={COMB: value}))
    field, middles = (COMBED, FINE), (np.arange(PLACES) + 0.5) * COMBED / PLACES
    asked = angle(np.stack(np.meshgrid(middles, middles), axis=-1))
    volume = above.opacities(found, alpha, field, FINE)
    lean = leans(volume, (1 / FINE, 1 / FINE), (PLACES, PLACES))[0]
    picture = above.picture(found, alpha, field, (0.0, 0.0, 1.0), FINE).mean(axis=-1)
    stroke = strokes(picture, (PLACES, PLACES))[0]
    return Combed(math.degrees(mean_error(lean, asked, 2 * math.pi)), math.degrees(mean_error(stroke, asked, math.pi)))


def _grown(bundle: Bundle, name: str, side: int, wanted: Wanted) -> tuple[Ready, Float[np.ndarray, "A"]]:
    """The material over `side` × `side` patches, and α."""
    if bundle.generator is not None:
        texels = round(side * bundle.texel_density)
        bundle = baked(bundle, name, (texels, texels), wanted)[0]
    return ready(bundle), normalised(bundle, {})
