"""Options of `mesoshell doctor`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """Check the installation: versions, devices, ray tracing, the Blender environment, the bundled material, and what
    is kept on the disk."""

    #: Remove what is kept: compiled programs, textures, unwrapped meshes and baked densities, which are made anew when needed.
    clear: bool = False
