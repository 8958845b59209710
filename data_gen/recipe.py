"""What a recipe is: a name, a version, its parameters, how its geometry grows and what it is made of.

Notation
    role      "alpha" for appearance (the decoder's input), "beta" for geometry (the mapping network's)
    range     (low, high), inclusive, in the parameter's own unit
    frame     the unit box [0, 1]³, z up: one patch; roots at z = 0, everything at z ≤ TOP
    L         side of the torus on which a recipe grows, in patches: 1 (a patch that repeats) or 3 (the whole slab)
    N, K      strands (or blades); points of one
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from data_gen.nodes import Nodes, Socket

TOP = 0.97
Values = Mapping[str, float]


class Parameter(NamedTuple):
    role: str
    range: tuple[float, float]
    default: float
    unit: str
    meaning: str


class Growth(NamedTuple):
    """N equal pieces: blades (triangles of a mesh) or strands (hair curves).

    points (N, K, 3); elements (F, 3) triangles or (K − 1, 2) segments, indices into K; along (K,) is 0 at the root
    and 1 at the tip; radius (N, K) of strands, None for blades; own: name -> (N,), a number a piece for the material.
    """

    points: np.ndarray
    elements: np.ndarray
    along: np.ndarray
    radius: np.ndarray | None
    own: Mapping[str, np.ndarray]


class Ground(NamedTuple):
    """What carries the strands; light sees it, the camera does not.  Lying exactly on the box's floor it would dot."""

    albedo: tuple[float, float, float]
    height: float = 0.03


class Recipe(NamedTuple):
    """`grow(rng, L, values)` covers [0, L)²; `surface(nodes, values)` gives the shader of a strand from sockets.

    A change that alters any pixel raises `version`; the version is part of the hash that draws the samples.
    irradiance: E⊥ of the light, chosen so that x / (1 + x) of the radiance lies mid-scale; samples: default number of
    light paths a pixel.
    """

    name: str
    version: int
    parameters: Mapping[str, Parameter]
    grow: Callable[[np.random.Generator, int, Values], Growth]
    surface: Callable[[Nodes, Mapping[str, Socket]], Socket]
    ground: Ground
    irradiance: float
    samples: int
