"""Blender as a camera: one scene, made once; then one image a sample.

Notation
    frame     the unit box [0, 1]³, z up; the camera looks along its −z with y up, pixel centres at +0.5
    spp       light paths a pixel
    E⊥        irradiance of the sun on the plane that faces it

A sun of strength s gives E⊥ = s on each channel: a white Lambertian plane facing it renders with radiance s / π
(measured: see the README).  Images are linear Rec. 709, half float, alpha premultiplied, no clamp, and
the pixel filter is a box one pixel wide, which is the footprint that a cone a pixel stands for.
"""

import time
from pathlib import Path

import bpy
import mathutils

from data_gen.sample import FIELD_OF_VIEW, Drawer, Sample
from data_gen.slab import Slab

BOUNCES = 8
CLIPPED_LAYERS = 256


class Studio:
    """Holds the scene of a dataset; `shoot` renders a sample to a file."""

    def __init__(self, drawer: Drawer, size: int, threads: int) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.drawer, recipe = drawer, drawer.recipe
        self.scene = bpy.context.scene
        self.scene.world = black_world()
        set_output(self.scene.render, size, threads)
        set_cycles(self.scene)
        self.camera = self._add("camera", bpy.data.cameras.new("camera"))
        self.camera.data.angle = FIELD_OF_VIEW
        self.camera.data.clip_start, self.camera.data.clip_end = 1e-3, 1e3
        self.scene.camera = self.camera
        self.sun = self._add("sun", bpy.data.lights.new("sun", "SUN"))
        self.sun.data.energy, self.sun.data.angle = recipe.irradiance, 0.0
        self.slab = Slab(recipe)
        self.grown: tuple | None = None

    def shoot(self, sample: Sample, spp: int, denoise: bool, path: Path) -> dict[str, float]:
        """Render to `path`; seconds spent on geometry and on Blender.  Raises `OSError` if the file cannot be written."""
        start = time.perf_counter()
        self._pose(sample)
        posed = time.perf_counter()
        cycles = self.scene.cycles
        cycles.seed, cycles.samples, cycles.use_denoising = sample.cycles_seed, spp, denoise
        self.scene.render.filepath = str(path.resolve())
        try:
            bpy.ops.render.render(write_still=True)
        except RuntimeError as error:
            raise OSError(f"not rendered: {str(error).splitlines()[0]}") from error
        return {"geometry": posed - start, "blender": time.perf_counter() - posed}

    def _pose(self, sample: Sample) -> None:
        self.camera.matrix_world = mathutils.Matrix(sample.camera_to_world.tolist())
        toward = mathutils.Vector(sample.light.tolist())
        self.sun.matrix_world = toward.to_track_quat("Z", "Y").to_matrix().to_4x4()
        kinds = {name: parameter.role for name, parameter in self.drawer.recipe.parameters.items()}
        for name, value in sample.parameters.items():
            if kinds[name] == "alpha":
                self.slab.set(name, value)
        shape = {name: value for name, value in sample.parameters.items() if kinds[name] == "beta"}
        if self.grown != (sample.instance, sample.side, shape):
            self.slab.fill(self.drawer.grow(sample), sample.side)
            self.grown = (sample.instance, sample.side, shape)

    def _add(self, name: str, data: bpy.types.ID) -> bpy.types.Object:
        made = bpy.data.objects.new(name, data)
        self.scene.collection.objects.link(made)
        return made


def black_world() -> bpy.types.World:
    world = bpy.data.worlds.new("black")
    world.node_tree.nodes.clear()
    return world


def set_output(render: bpy.types.RenderSettings, size: int, threads: int) -> None:
    render.engine = "CYCLES"
    render.resolution_x = render.resolution_y = size
    render.resolution_percentage = 100
    render.film_transparent = True
    render.use_persistent_data = True
    render.use_file_extension = False
    render.use_compositing = render.use_sequencer = False
    render.threads_mode, render.threads = ("FIXED", threads) if threads else ("AUTO", 1)
    image = render.image_settings
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGBA", "16", "ZIP"
    for name in dir(render):
        if name.startswith("use_stamp"):
            setattr(render, name, False)


def set_cycles(scene: bpy.types.Scene) -> None:
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = cycles.use_light_tree = cycles.use_auto_tile = False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.transmission_bounces = cycles.glossy_bounces = BOUNCES
    cycles.transparent_max_bounces = CLIPPED_LAYERS
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0.0
    cycles.pixel_filter_type = "BOX"
    scene.cycles_curves.shape = "RIBBONS"
