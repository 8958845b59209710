"""mesoshell: grass, carpet and fur for any mesh, as neural reflectance shells.

    import mesoshell as ms

    material = ms.load_material("grass")
    scene = ms.Scene("bunny.obj", material, thickness=0.06, scale=0.25)
    ms.render(scene, quality="draft").save("bunny.png")

Names are imported when they are first used: importing this package loads no JAX. `mesoshell.film`, `.render`, `.stability`,
`.tradeoff` and `.train` are packages that can be called: a call runs the library's function of that name
(docs/tutorials/library.md).
"""

import sys
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inspect import Signature

    from mesoshell import modules as modules
    from mesoshell import pathtracer as mitsuba
    from mesoshell.api.learning import Fit, Run, fit, prefilter, train
    from mesoshell.api.rendering import explain, film, render, stability, tradeoff, write_scene
    from mesoshell.errors import InputError
    from mesoshell.film.shoot import Film
    from mesoshell.render.camera import Camera, look_at
    from mesoshell.render.effects import Effects
    from mesoshell.render.lamp import Lamp
    from mesoshell.render.light import Distant
    from mesoshell.render.quality import Quality
    from mesoshell.scene.materials import Material, load_material
    from mesoshell.scene.picture import Picture
    from mesoshell.scene.scene import Grown, Scene

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Distant",
    "Effects",
    "Film",
    "Fit",
    "Grown",
    "InputError",
    "Lamp",
    "Material",
    "Picture",
    "Quality",
    "Run",
    "Scene",
    "__version__",
    "explain",
    "film",
    "fit",
    "load_material",
    "look_at",
    "mitsuba",
    "modules",
    "prefilter",
    "render",
    "stability",
    "tradeoff",
    "train",
    "write_scene",
]

#: The module that defines each name.
_HOMES = {
    "Camera": "mesoshell.render.camera",
    "Distant": "mesoshell.render.light",
    "Effects": "mesoshell.render.effects",
    "Film": "mesoshell.film.shoot",
    "Fit": "mesoshell.api.learning",
    "Grown": "mesoshell.scene.scene",
    "InputError": "mesoshell.errors",
    "Lamp": "mesoshell.render.lamp",
    "Material": "mesoshell.scene.materials",
    "Picture": "mesoshell.scene.picture",
    "Quality": "mesoshell.render.quality",
    "Run": "mesoshell.api.learning",
    "Scene": "mesoshell.scene.scene",
    "explain": "mesoshell.api.rendering",
    "fit": "mesoshell.api.learning",
    "load_material": "mesoshell.scene.materials",
    "look_at": "mesoshell.render.camera",
    "prefilter": "mesoshell.api.learning",
    "write_scene": "mesoshell.api.rendering",
}
#: Packages that are names of the library.
_ROOMS = {"mitsuba": "mesoshell.pathtracer", "modules": "mesoshell.modules"}
#: Packages that can be called, and the module that defines each function.
_FUNCTIONS = {
    "mesoshell.film": "mesoshell.api.rendering",
    "mesoshell.render": "mesoshell.api.rendering",
    "mesoshell.stability": "mesoshell.api.rendering",
    "mesoshell.tradeoff": "mesoshell.api.rendering",
    "mesoshell.train": "mesoshell.api.learning",
}


class _Room(ModuleType):
    """A package that can be called as a function of the library."""

    @property
    def __call__(self) -> Callable[..., Any]:
        return getattr(import_module(_FUNCTIONS[self.__name__]), self.__name__.rpartition(".")[2])

    @property
    def __signature__(self) -> "Signature":
        from inspect import signature

        return signature(self.__call__)


for _name in _FUNCTIONS:
    import_module(_name)
    sys.modules[_name].__class__ = _Room


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(_ROOMS[name])
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
