"""Pictures of a captured object that refine, with what is set of it: paint over its texture, a sun, a checkerboard.

Notation
T           the object's texture as a cubemap, six squares of SIDE texels
world       of the capture, whose photographs' mean upward direction is up
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.neutex import render as rendering
from mesoshell.neutex.cameras import photo_of, pixels, up_of
from mesoshell.neutex.edit import board_paint, paint_over, texture_image
from mesoshell.neutex.layout import shape
from mesoshell.neutex.mesh import extract_mesh
from mesoshell.neutex.render import Lighting, march_pixels, occupancy
from mesoshell.neutex.store import NeuTexModel
from mesoshell.render.camera import Camera, in_pixel, outward
from mesoshell.render.quality import Quality
from mesoshell.scene.setup import light_of
from mesoshell.viewer.look import Painting, with_size
from mesoshell.viewer.refine import COARSE, Abandoned
from mesoshell.viewer.sun import toward_sun
from mesoshell.viewer.views import View, Views

#: Texels a side of a cubemap's squares; quads a side of the mesh that is painted on.
SIDE, QUADS = 128, 48
#: Rays between looks at whether anybody still waits; most rays a pixel.
RAYS, MOST = 16384, 64
#: Irradiance of the sun.
IRRADIANCE = 3.0


@dataclass(frozen=True)
class ObjectLook:
    """What is set. painted: over the texture, linear premultiplied RGBA as a cubemap; checker: a checkerboard in its place;
    sun: azimuth and elevation, degrees, None for the photographs' light; quality: a preset's name; side: pixels of the longer
    side."""

    painted: Painting | None = None
    checker: bool = False
    sun: tuple[float, float] | None = None
    quality: str = "normal"
    side: int = 256


class ObjectPicture(NamedTuple):
    """A picture on its way. rgba: linear, premultiplied; rays: of each pixel; samples: of a ray; seconds: of the last pass."""

    rgba: Float[np.ndarray, "H W 4"]
    rays: int
    samples: int
    seconds: float


class CapturedObject:
    """An object, with what its pictures share. prepare: make what a page would wait for."""

    def __init__(self, model: NeuTexModel):
        self.model = model
        self._occupied: dict[float, Any] = {}

    def prepare(self) -> None:
        if self.has_texture:
            _ = self.texture

    @property
    def has_texture(self) -> bool:
        return self.model.config.colour != "volume"

    @property
    def is_lit(self) -> bool:
        """Whether a light can be set."""
        return self.model.config.colour == "reflectance"

    @cached_property
    def texture(self) -> Float[np.ndarray, "h w 3"]:
        """T, linear."""
        return texture_image(self.model, "cubemap", SIDE)

    @cached_property
    def mesh(self) -> Mesh:
        """Its surface in the world, with the cubemap's coordinates."""
        m = self.model
        made = extract_mesh(m.config, m.field, QUADS, SIDE)
        return check_mesh(m.centre + m.half * made.vertices, made.faces, made.uv[made.faces], "the object")

    @cached_property
    def up(self) -> Float[np.ndarray, "3"]:
        up = up_of(self.model.photos)
        return np.array([0.0, 1.0, 0.0]) if up is None else up

    def shown(self, look: ObjectLook) -> Float[np.ndarray, "h w 3"]:
        """The texture as it is shown."""
        if look.checker:
            return board_paint().image[..., :3]
        return self.texture if look.painted is None else composite_over(self.texture, look.painted)

    def view(self, look: ObjectLook, quality: Quality) -> rendering.View:
        """How a look shows it."""
        if quality.skip not in self._occupied:
            self._occupied[quality.skip] = occupancy(self.model.config, self.model.field, quality.skip)
        paint, lit = None, None
        if look.checker and self.has_texture:
            paint = board_paint()
        elif look.painted is not None:
            paint = paint_over(self.texture, "cubemap", look.painted.image)
        if look.sun is not None and self.is_lit:
            toward = toward_sun(self.model.photos[0].to_world, self.up, look.sun)
            lit = Lighting((light_of(toward, IRRADIANCE),), None)
        return rendering.View(quality, self._occupied[quality.skip], paint, lit)


class ObjectWorkshop(Views[ObjectPicture]):
    """Paints what eyes see of a captured object."""

    def __init__(self, model: NeuTexModel, show: Callable[[Any], None], say: Callable[[str], None]):
        super().__init__(show, say)
        self.look, self.object = ObjectLook(), CapturedObject(model)
        self.object.prepare()
        self._start()

    def set(self, look: ObjectLook) -> None:
        """Show another look to all."""
        with self._changed:
            if look != self.look:
                self.look = look
                self._ask_all()

    def set_object(self, captured: CapturedObject) -> None:
        """Show another object."""
        with self._changed:
            self.object = captured
            self._ask_all()

    def _refined(self, view: View[ObjectPicture], stopped: Callable[[], bool]) -> Iterator[ObjectPicture]:
        return refine_object(self.object, self.look, view.camera, stopped)


def refine_object(
    captured: CapturedObject, look: ObjectLook, camera: Camera, stopped: Callable[[], bool], most: int = MOST
) -> Iterator[ObjectPicture]:
    """Ever better pictures, up to `most` rays a pixel; first one of few pixels and half of the samples. Ends early once
    `stopped` says so."""
    quality = captured.model.quality(look.quality)
    stages = [(with_size(camera, look.side), quality, most)]
    if look.side > COARSE:
        coarse = captured.model.quality("draft")
        coarse = coarse.with_changes(samples=max(1, coarse.samples // 2))
        stages.insert(0, (with_size(camera, COARSE), coarse, 1))
    try:
        for sized, settings, count in stages:
            yield from _passes(captured, look, sized, settings, count, stopped)
    except Abandoned:
        return


def _passes(
    captured: CapturedObject,
    look: ObjectLook,
    camera: Camera,
    quality: Quality,
    count: int,
    stopped: Callable[[], bool],
) -> Iterator[ObjectPicture]:
    model, how = captured.model, captured.view(look, quality)
    photo = photo_of(camera)
    boxed, middle = model.to_box(photo), pixels(photo)
    total = np.zeros((len(middle), 4))
    begin = time.perf_counter()
    for k in range(count):
        place = np.floor(middle) + in_pixel(outward(k))
        for first in range(0, len(place), RAYS):
            if stopped():
                raise Abandoned
            some = slice(first, first + RAYS)
            total[some] += march_pixels(model.config, model.field, boxed, how, place[some], outward(k))[:, :4]
        now = time.perf_counter()
        image = (total / (k + 1)).reshape(photo.height, photo.width, 4)
        yield ObjectPicture(image, k + 1, quality.samples, now - begin)
        begin = time.perf_counter()


def composite_over(texture: Float[np.ndarray, "h w 3"], painting: Painting) -> Float[np.ndarray, "h w 3"]:
    """A texture beneath paint, linear."""
    return painting.image[..., :3] + (1 - painting.image[..., 3:]) * texture


def blank() -> Float[np.ndarray, "h w 4"]:
    """No paint."""
    return np.zeros((*shape("cubemap", SIDE), 4), np.float32)
