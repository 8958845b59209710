"""Options of `mesoshell doctor`: none."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """Check the installation: versions, devices, ray tracing, the Blender environment, the bundled material."""
