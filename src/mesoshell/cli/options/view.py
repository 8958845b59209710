"""Options of `mesoshell view`."""

from dataclasses import dataclass

from mesoshell.cli.scene_options import SceneOptions


@dataclass(frozen=True)
class Options(SceneOptions):
    """View a scene in the browser: camera by mouse, sliders for parameters, progressive pictures.

    Requires the extra `viewer`; Ctrl-C ends it. Give a training run's folder as the mesh or as --material to show its newest
    snapshot, with its sheets and curves as it trains; as the mesh, it is shown on a bundled one. A run of `atlas train`, as the
    mesh, is shown as the object that it learned, with its texture, to paint on."""

    #: Second material on the same mesh, with its own parameters, thickness and scale, to compare with by a wipe.
    beside: str | None = None
    #: Address to listen on. Anyone who can reach it can view the scene, and load this machine.
    host: str = "127.0.0.1"
    #: Port to listen on.
    port: int = 8080
