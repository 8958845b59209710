"""MP4 files of frames, by ffmpeg (extra `film`)."""

import contextlib
import importlib.util
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from mesoshell.errors import Argument, InputError
from mesoshell.io.atomic import move_together

#: Constant rate factor of H.264: 0 is lossless, 51 worst.
QUALITY = 17
#: H.264 that browsers play, and which primaries, curve and matrix they are to use.
ENCODING = f"-c:v libx264 -crf {QUALITY} -preset slow -pix_fmt yuv420p -movflags +faststart -map_metadata -1"
COLOURS = "-vf scale=out_color_matrix=bt709 -colorspace bt709 -color_primaries bt709 -color_trc iec61966-2-1"


def check_mp4(path: Path, size: tuple[int, int], fps: float, source: str) -> None:
    """Raise InputError unless an MP4 of this size can be written. source: of the path, in errors."""
    if path.suffix.lower() != ".mp4":
        raise InputError(source, f"{path} must end in .mp4")
    if not 0 < fps < np.inf:
        raise InputError(Argument("fps"), f"must be positive and finite, not {fps:g}")
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        raise InputError(source, "an MP4 requires imageio-ffmpeg: pip install mesoshell[film]; or give a folder")
    if any(n % 2 for n in size):
        raise InputError(Argument("size"), f"an MP4 has an even width and height, not {size[0]} x {size[1]}")


def write_mp4(path: Path, frames: Iterable[UInt8[np.ndarray, "H W 3"]], size: tuple[int, int], fps: float) -> None:
    """Write frames, sRGB. size: width and height. Raises InputError if the file cannot be written."""
    from imageio_ffmpeg import get_ffmpeg_exe

    given = f"-loglevel error -f rawvideo -pix_fmt rgb24 -s {size[0]}x{size[1]} -r {float(fps)!r} -i -".split()
    with move_together(path) as folder:
        made = folder / path.name
        command = [get_ffmpeg_exe(), *given, *ENCODING.split(), *COLOURS.split(), str(made)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as encoder:
            assert encoder.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # it ended, and says why
                for frame in frames:
                    encoder.stdin.write(frame.tobytes())
            message = encoder.communicate()[1].decode(errors="replace").strip()
        if encoder.returncode:
            raise InputError(path, f"cannot be encoded: {(message.splitlines() or ['ffmpeg gives no reason'])[-1]}")
