"""A scene that an engine is ready to render, and the picture that it gives (no JAX)."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mesoshell import __version__
from mesoshell.errors import Argument, InputError
from mesoshell.io.image import png_bytes, write_exr, write_png
from mesoshell.render.camera import Camera
from mesoshell.render.effects import Effects
from mesoshell.render.quality import Quality
from mesoshell.render.tiles import TileRenderer, render_pass, threads
from mesoshell.scene.scene import Grown, Scene

#: Called with the share done, 0 to 1.
Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Picture:
    """A rendered picture; a notebook displays it. rgba: linear Rec. 709, premultiplied; report: JSON: seconds and counts,
    effects, quality and material; notes: what the user should know, a line each."""

    rgba: Float[np.ndarray, "H W 4"]
    report: dict[str, Any] = field(repr=False)
    notes: tuple[str, ...] = ()

    def save(self, path: str | PathLike[str]) -> None:
        """Write it: sRGB with straight alpha as .png, linear and premultiplied as .exr. Raises InputError for another suffix,
        or if the file cannot be written."""
        writers = {".png": write_png, ".exr": write_exr}
        suffix = Path(path).suffix.lower()
        if suffix not in writers:
            raise InputError(Argument("path"), f"{fspath(path)} must end in .png or .exr")
        writers[suffix](path, self.rgba)

    def _repr_png_(self) -> bytes:
        return png_bytes(self.rgba)


class Rendered(NamedTuple):
    """What an engine gives: linear premultiplied RGBA, seconds by stage, and its part of the report. notes: as of a Picture."""

    rgba: Float[np.ndarray, "H W 4"]
    seconds: dict[str, float]
    record: dict[str, Any]
    notes: tuple[str, ...] = ()


class Passes(NamedTuple):
    """A picture that is made pass by pass, a sample a pixel each. shape: H, W; chosen: whether a pass may leave pixels out;
    threads: that a pass of so many pixels keeps busy; render: (number of the pass, pixels by row, progress) -> their RGBA;
    ended: what an engine gives, from the picture that passes came to and its samples a pixel; compile: all that passes may
    call, where it is known before."""

    shape: tuple[int, int]
    chosen: bool
    threads: Callable[[int], int]
    render: Callable[[int, Int[np.ndarray, "P"], Progress], Float[np.ndarray, "P 4"]]
    ended: Callable[[np.ndarray, int], Rendered]
    compile: Callable[[], None] = lambda: None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene that an engine is ready to render. material: the report's part about it; effects: None for a scene of Mitsuba's
    that holds no shell; notes: what the user should know, a line each; begun: `time.perf_counter` when set-up began; setup:
    seconds that it took; work: renders the scene; passes: begins to render it pass by pass, with another
    quality if one is given."""

    engine: str
    material: dict[str, Any]
    effects: Effects | None
    notes: tuple[str, ...]
    begun: float
    setup: float
    work: Callable[[Progress], Rendered]
    passes: Callable[[Quality | None], Passes]

    @classmethod
    def now(
        cls,
        scene: Scene,
        engine: str,
        effects: Effects,
        notes: tuple[str, ...],
        begun: float,
        work: Callable[[Progress], Rendered],
        passes: Callable[[Quality | None], Passes],
    ) -> "Prepared":
        """A scene that has just become ready."""
        return cls(engine, _about(scene), effects, notes, begun, time.perf_counter() - begun, work, passes)

    def picture(self, progress: Progress = lambda share: None) -> Picture:
        """Render it."""
        return self.presented(self.work(progress))

    def presented(self, rendered: Rendered) -> Picture:
        """What an engine gave, with what is known of the scene."""
        seconds = {"setup": self.setup, **rendered.seconds, "total": time.perf_counter() - self.begun}
        about = {"version": __version__, "engine": self.engine}
        report = about | rendered.record | {"material": self.material, "seconds": seconds}
        return Picture(rendered.rgba, report, (*self.notes, *rendered.notes))


def tiled_passes(camera: Camera, size: int, tile: TileRenderer, ended: Callable[[np.ndarray, int], Rendered]) -> Passes:
    """Passes of one ray a pixel. size: most rays a tile."""

    def render_one(k: int, pixels: np.ndarray, progress: Progress) -> np.ndarray:
        return render_pass(camera, k, pixels, size, tile, progress)

    return Passes((camera.height, camera.width), True, lambda pixels: threads(pixels, size), render_one, ended)


def _about(scene: Scene) -> dict[str, Any]:
    """The report's part about materials."""
    return _of(scene) | ({"also": [_of(part) for part in scene.also]} if scene.also else {})


def _of(part: Scene | Grown) -> dict[str, Any]:
    """A material's name, the parameters given, and its provenance."""
    given = {
        name: f"an image of {' x '.join(map(str, value.shape))}" if isinstance(value, np.ndarray) else value
        for name, value in part.params.items()
    }
    given = {name: str(x) if isinstance(x, str | PathLike) else float(x) for name, x in given.items()}
    drawn: dict[str, Any] = {} if part.seed is None else {"seed": int(part.seed)}
    if part.latent is not None:
        drawn["latent"] = [int(part.latent[0]), float(part.latent[1])]
    return {"name": part.material.name, "parameters": given, **part.material.provenance, **drawn}
