"""Blender as a camera: one scene, made once; then one image a sample.

Alphabet
    frame     the unit box [0, 1]³, z up; the camera looks along its −z with y up, pixel centres at +0.5
    S, P      image side in pixels; light paths a pixel
    E⊥        irradiance of the sun on the plane that faces it

A sun of strength s gives E⊥ = s on each channel: a white Lambertian plane facing it renders with radiance s / π
(measured: see the README).  Images are linear Rec. 709, half float, alpha premultiplied, no denoiser, no clamp, and
the pixel filter is a box one pixel wide, which is the footprint that a cone a pixel stands for.
"""

from collections.abc import Mapping
from pathlib import Path

import bpy
import mathutils
import numpy as np

from data_gen.recipe import Recipe
from data_gen.sample import FIELD_OF_VIEW, Sample

SUN = 40.0
BOUNCES = 8
CLIPPED_LAYERS = 256


class Studio:
    """Holds the scene of one recipe; `shoot` renders a sample to a file."""

    def __init__(self, recipe: Recipe, size: int, samples_per_pixel: int, threads: int) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self.scene.world = black_world()
        set_output(self.scene.render, size, threads)
        set_cycles(self.scene, samples_per_pixel)
        self.camera = self._add("camera", bpy.data.cameras.new("camera"))
        self.camera.data.angle = FIELD_OF_VIEW
        self.camera.data.clip_start, self.camera.data.clip_end = 1e-3, 1e3
        self.scene.camera = self.camera
        self.sun = self._add("sun", bpy.data.lights.new("sun", "SUN"))
        self.sun.data.energy, self.sun.data.angle = SUN, 0.0
        self.set_parameters = recipe.build()

    def shoot(self, sample: Sample, path: Path) -> None:
        """Raises `OSError` if Blender cannot write the file."""
        self._pose(sample.camera_to_world, sample.light, sample.parameters)
        self.scene.cycles.seed = sample.cycles_seed
        self.scene.render.filepath = str(path.resolve())
        try:
            bpy.ops.render.render(write_still=True)
        except RuntimeError as error:
            raise OSError(f"{path}: not rendered: {str(error).splitlines()[0]}") from error

    def _pose(self, camera_to_world: np.ndarray, light: np.ndarray, parameters: Mapping[str, float]) -> None:
        self.camera.matrix_world = mathutils.Matrix(camera_to_world.tolist())
        toward = mathutils.Vector(light.tolist())
        self.sun.matrix_world = toward.to_track_quat("Z", "Y").to_matrix().to_4x4()
        self.set_parameters(parameters)

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


def set_cycles(scene: bpy.types.Scene, samples_per_pixel: int) -> None:
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = samples_per_pixel
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = cycles.use_auto_tile = False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.transmission_bounces = cycles.glossy_bounces = BOUNCES
    cycles.transparent_max_bounces = CLIPPED_LAYERS
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0.0
    cycles.pixel_filter_type = "BOX"
