"""Options of `mesoshell render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mesoshell.cli.scene_options import SETTINGS_HELP, SceneOptions


def _file(text: list[str]) -> Path:
    if not Path(text[0]).name or text[0].endswith("/"):
        raise ValueError(f"{text[0]!r} names no file")
    return Path(text[0])


#: The path of a file: one that ends in a slash is refused.
FILE = tyro.constructors.PrimitiveConstructorSpec(
    nargs=1,
    metavar="PATH",
    instance_from_str=_file,
    is_instance=lambda x: isinstance(x, Path),
    str_from_instance=lambda x: [str(x)],
)


@dataclass(frozen=True)
class Options(SceneOptions):
    """Render a mesh grown with a neural material; writes OUT.png (sRGB), OUT.exr (linear RGBA) and OUT.json."""

    #: Effort: draft for a quick look, normal for pictures, reference to measure the others by. Default: normal; with --budget
    #: or --error, a march's settings are chosen for the scene unless --quality or --set is given.
    quality: Literal["draft", "normal", "reference"] | None = None
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(help=SETTINGS_HELP)] = ()
    #: Seconds for the render loop, which takes as many samples as fit. Set-up and compile times are reported separately.
    budget: float | None = None
    #: Mean FLIP of the tone-mapped picture to reach, 0 to 1, with as few samples as needed. With --budget too, rendering ends
    #: at whichever is reached first.
    error: float | None = None
    #: Maximum number of samples a pixel, alone or with --budget or --error (then 4096 by default). Ctrl-C writes the picture so
    #: far.
    max_samples: int | None = None
    #: Paths a pixel, for mitsuba. Default: the setting spp of the --quality, or what the XML scene says.
    spp: int | None = None
    #: Maximum number of segments of a path, for mitsuba; 2 is direct light only. Default: the setting max_depth of the
    #: --quality.
    max_depth: int | None = None
    #: Print which effects the scene calls for, and why.
    explain: bool = False
    #: The picture to write.
    out: Annotated[Path, FILE] = Path("out/render.png")
