"""What a recipe is: a name, a version, its parameters, and how its scene is built.

Alphabet
    role      "alpha" for appearance (the decoder's input), "beta" for geometry (the mapping network's)
    range     (low, high), inclusive, in the parameter's own unit
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple


class Parameter(NamedTuple):
    role: str
    range: tuple[float, float]
    default: float
    unit: str
    meaning: str


class Recipe(NamedTuple):
    """`build()` makes the objects in Blender's current scene and returns the function that sets the parameters.

    A change that alters any pixel raises `version`; the version is part of the hash that draws the samples.
    """

    name: str
    version: int
    parameters: Mapping[str, Parameter]
    build: Callable[[], Callable[[Mapping[str, float]], None]]
