"""Options of `mesoshell view`."""

from dataclasses import dataclass

from mesoshell.cli.scene_options import SceneOptions


@dataclass(frozen=True)
class Options(SceneOptions):
    """Look at a scene in the browser: camera by mouse, parameters by sliders, pictures that refine. Needs the extra `viewer`;
    ends with Ctrl-C. In place of the mesh, or of the material, the folder of a training run: its newest snapshot, on a
    bundled mesh or on this one, beside its sheets and curves as it trains."""

    #: Another material on the same mesh, with parameters, thickness and scale of its own, to compare with by a wipe.
    beside: str | None = None
    #: Address to listen on. Whoever reaches it can look, and make this machine work.
    host: str = "127.0.0.1"
    #: Port to listen on.
    port: int = 8080
