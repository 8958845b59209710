"""Images of Radiance, .hdr: linear colours of three bytes and an exponent that they share (Ward 1991).

Notation
m, e        bytes of a pixel: red, green, blue and the exponent; its colour is m 2^(e − 136) over the exposures of the header, 0
            where e is 0
run         a byte n > 128, and one that is repeated n − 128 times; or n ≤ 128, and n bytes that follow

Each row of a file as most programs write it holds its reds, greens, blues and exponents in turn, in runs.
"""

import re
from os import PathLike

import numpy as np
from jaxtyping import Float32, UInt8

from mesoshell.errors import InputError
from mesoshell.limits import check_memory

MAGIC = b"#?"
#: Widths of rows in runs; bytes at their beginning.
WIDTHS, BEGIN = range(8, 32768), b"\x02\x02"


def hdr_image(data: bytes, path: str | PathLike[str]) -> Float32[np.ndarray, "H W 3"]:
    """Linear RGB, the first row on top. Raises InputError(path, …) for what is no such file, or is cut off."""
    head, blank, rest = data.partition(b"\n\n")
    lines = head.decode("latin-1").split("\n")
    place, end, body = rest.partition(b"\n")
    size = re.fullmatch(rb"-Y (\d{1,7}) \+X (\d{1,7})", place.strip())
    if not (data.startswith(MAGIC) and blank and end):
        raise InputError(path, "is no image of Radiance: its header has no end")
    if "FORMAT=32-bit_rle_rgbe" not in lines:
        raise InputError(path, "is no image of Radiance's in RGB: its header has no line FORMAT=32-bit_rle_rgbe")
    if size is None:
        raise InputError(path, f"has the size and order {place[:40].decode('latin-1')!r}; expected -Y HEIGHT +X WIDTH")
    height, width = int(size[1]), int(size[2])
    if not height or not width:
        raise InputError(path, f"{width} x {height} has no pixels")
    check_memory(path, f"an image of {width} x {height}", 32 * width * height)
    scales = np.exp2(np.arange(256) - 136.0) / _exposure(lines, path)
    scales[0] = 0
    pixels = _pixels(body, height, width, path)
    with np.errstate(over="ignore"):  # who reads light says what is too bright
        return pixels[..., :3] * scales.astype(np.float32)[pixels[..., 3:]]


def _exposure(lines: list[str], path: str | PathLike[str]) -> float:
    """The product of the header's exposures."""
    exposure = 1.0
    for line in lines:
        if line.startswith("EXPOSURE="):
            try:
                exposure *= float(line.partition("=")[2])
            except ValueError:
                exposure = 0.0
            if not 1e-30 < exposure < 1e30:
                raise InputError(path, f"has the exposure {line!r}")
    return exposure


def _pixels(body: bytes, height: int, width: int, path: str | PathLike[str]) -> UInt8[np.ndarray, "H W 4"]:
    """Bytes of all pixels."""
    if width not in WIDTHS or not (body.startswith(BEGIN) and len(body) > 2 and body[2] < 128):
        plain = np.frombuffer(body[: 4 * height * width], np.uint8)
        if plain.size < 4 * height * width:
            raise InputError(path, "is cut off, or in an older kind of runs")
        return plain.reshape(height, width, 4)
    pixels, at = np.empty((height, 4, width), np.uint8), 0
    begin = BEGIN + width.to_bytes(2, "big")
    for row in pixels:
        if body[at : at + 4] != begin:
            raise InputError(path, "is cut off, or damaged: a row does not begin as the first")
        at += 4
        for channel in row:
            done = 0
            while done < width:
                n = body[at] if at < len(body) else 0
                length = n - 128 if n > 128 else n
                values = body[at + 1 : at + 2] * length if n > 128 else body[at + 1 : at + 1 + n]
                if not length or len(values) < length or done + length > width:
                    raise InputError(path, "is cut off, or damaged: a run does not fit its row")
                channel[done : done + length] = np.frombuffer(values, np.uint8)
                done, at = done + length, at + (2 if n > 128 else 1 + n)
    return pixels.transpose(0, 2, 1)
