"""What rays may meet in a scene with shells, as integrators hold it.

Not a dataclass: Dr.Jit would take its parts for the state of loops.
"""

import drjit as dr


class World:
    """shells, media: what is in them; quality: render/quality; scene and lights: for `direct`, surfaces and distant lights,
    (unit direction toward it, E⊥) each.

    camera_outside: no ray of the camera begins in a shell; shell_shadows: shells dim what lights other things, and themselves
    where light has left them; hide_emitters: the camera does not see the environment.
    """

    def __init__(self, shells, media, quality, scene=None, lights=()):
        self.shells, self.media, self.quality, self.scene, self.lights = shells, media, quality, scene, lights
        self.camera_outside, self.shell_shadows, self.hide_emitters = False, True, False

    def cone(self, ray, sampler):
        """ṙ of the cone of a pixel: differentials are those of a sample, √count times narrower."""
        width = dr.norm(ray.d_x - ray.d) * sampler.sample_count() ** 0.5
        return width * (2 / 12**0.5)
