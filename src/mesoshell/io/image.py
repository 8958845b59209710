"""Images on disk: OpenEXR for radiance, PNG for looking at (NumPy only).

symbol  meaning                                             shape, unit
H W C   rows (top first), columns, channels: RGB or RGBA    C is 3 or 4
x       linear value, Rec. 709 primaries                    1 is the display's white
v       sRGB-encoded value (IEC 61966-2-1)                  [0, 1] for x in [0, 1]
α       coverage                                            [0, 1]

Alpha is premultiplied everywhere in memory and in EXR (the format's own convention); PNG holds straight alpha.
Every writer makes the whole file in memory and hands it to `replace_file`: no half-written image is ever left.
"""

import io
from os import PathLike

import numpy as np
from jaxtyping import Float, Float32, UInt8

from mesoshell.contained import silent
from mesoshell.errors import InputError
from mesoshell.io.atomic import read_file, replace_file
from mesoshell.io.radiance_hdr import MAGIC as HDR_MAGIC
from mesoshell.io.radiance_hdr import hdr_image

_EXR_MAGIC = b"\x76\x2f\x31\x01"
HALF_MAX = 65504.0
#: What Pillow refuses to decode.
VAST = "has more pixels than are read: 179 million"


def read_exr(path: str | PathLike[str]) -> Float32[np.ndarray, "H W C"]:
    """The data window of the first part of an OpenEXR file, half or float, as (H, W, 3) RGB or (H, W, 4) RGBA.

    Other channels and layers are ignored. NaN and infinity come back as they are. Raises InputError if the file is
    missing, is not OpenEXR, is corrupt or truncated, or has no full-resolution half or float R, G and B.
    """
    return exr_image(read_file(path), path)


def exr_image(data: bytes, path: str | PathLike[str]) -> Float32[np.ndarray, "H W C"]:
    """What `read_exr` gives, of the bytes of a file. Raises InputError(path, …) as it does."""
    if not data.startswith(_EXR_MAGIC):
        raise InputError(path, "not an OpenEXR file")
    planes = _exr_planes(path, data)
    if not {"R", "G", "B"} <= planes.keys():
        raise InputError(path, f"has no R, G and B channels (found: {', '.join(map(repr, sorted(planes))) or 'none'})")
    order = [name for name in "RGBA" if name in planes]
    for name in order:
        if planes[name].dtype not in (np.float16, np.float32):
            raise InputError(path, f"channel {name} holds {planes[name].dtype}; expected half or float")
        if planes[name].shape != planes["R"].shape:
            raise InputError(path, f"channel {name} is subsampled; expected full resolution")
    return np.stack([planes[name].astype(np.float32) for name in order], axis=-1)


def read_radiance(path: str | PathLike[str]) -> Float32[np.ndarray, "H W 3"]:
    """Light of an OpenEXR file, or of one of Radiance (.hdr), by what is in it. Raises InputError."""
    return radiance_of(read_file(path), path)


def radiance_of(data: bytes, path: str | PathLike[str]) -> Float32[np.ndarray, "H W 3"]:
    """What `read_radiance` gives, of the bytes of a file. Raises InputError(path, …) as it does."""
    if data.startswith(HDR_MAGIC):
        return hdr_image(data, path)
    if not data.startswith(_EXR_MAGIC):
        raise InputError(path, "is neither an OpenEXR file nor one of Radiance (.hdr)")
    return exr_image(data, path)[..., :3]


def write_exr(path: str | PathLike[str], image: Float[np.ndarray, "H W C"], half: bool = True) -> None:
    """Write linear RGB (H, W, 3) or premultiplied RGBA (H, W, 4) as OpenEXR, lossless ZIP, half or float channels.

    Finite values beyond half's range are written as ±65504; NaN and infinity as they are. Raises InputError if `image`
    has another shape or the file cannot be written.
    """
    replace_file(path, exr_bytes(image, half, path))


def exr_bytes(image: Float[np.ndarray, "H W C"], half: bool = True, source: str | PathLike[str] = "image") -> bytes:
    """The bytes that `write_exr` writes. Raises InputError(source, …) as it does."""
    import OpenEXR

    pixels = _checked(source, image).astype(np.float32)
    if half:
        pixels = np.where(np.isfinite(pixels), np.clip(pixels, -HALF_MAX, HALF_MAX), pixels).astype(np.float16)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    stream = io.BytesIO()
    OpenEXR.File(header, {"RGBA"[: pixels.shape[2]]: np.ascontiguousarray(pixels)}).write(stream)
    return stream.getvalue()


def read_png(path: str | PathLike[str]) -> Float32[np.ndarray, "H W C"]:
    """What write_png writes: an 8-bit PNG as linear RGB (H, W, 3), or premultiplied RGBA (H, W, 4) if it has alpha.

    Grey and palette images are expanded. Raises InputError if the file is missing, not a PNG, corrupt, or 16-bit grey.
    """
    return _decoded(path, read_file(path), "PNG")


def read_picture(path: str | PathLike[str]) -> Float32[np.ndarray, "H W C"]:
    """A photograph: OpenEXR as `read_exr`, PNG and JPEG as `read_png`, by what is in the file and not by its name."""
    return picture_of(read_file(path), path)


def picture_of(data: bytes, path: str | PathLike[str]) -> Float32[np.ndarray, "H W C"]:
    """What `read_picture` gives, of the bytes of a file. Raises InputError(path, …) as it does."""
    if data.startswith(_EXR_MAGIC):
        return exr_image(data, path)
    return _decoded(path, data, "JPEG" if data.startswith(b"\xff\xd8") else "PNG")


def _decoded(path: str | PathLike[str], data: bytes, form: str) -> Float32[np.ndarray, "H W C"]:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=[form]) as picture:
            if picture.mode.startswith("I"):
                raise InputError(path, "16-bit grey PNG; expected 8 bits per channel")
            codes = np.asarray(picture.convert("RGBA" if picture.has_transparency_data else "RGB"))
    except InputError:
        raise
    except Image.DecompressionBombError as error:
        raise InputError(path, VAST) from error
    except Exception as error:  # the decoder throws OSError, SyntaxError, ValueError, struct.error, zlib.error, …
        raise InputError(path, f"not a {form} file, or a corrupt one") from error
    values = codes.astype(np.float32) / np.float32(255)
    colour = srgb_to_linear(values[..., :3])
    alpha = values[..., 3:]
    return np.concatenate([colour * alpha, alpha], axis=-1) if alpha.size else colour


def read_heights(path: str | PathLike[str]) -> Float32[np.ndarray, "H W"]:
    """One number per pixel: the first channel of an OpenEXR file as stored, or the codes of any other image divided by the
    largest code (8 or 16 bits), colours averaged. Raises InputError if the file is missing, not an image, or deep."""
    from PIL import Image

    data = read_file(path)
    if data.startswith(_EXR_MAGIC):
        planes = {
            name: x for name, x in _exr_planes(path, data).items() if x.dtype != object
        }  # deep channels are objects
        if not planes:
            raise InputError(path, "has no channel with one number a pixel")
        return next(planes[name] for name in ("R", "Y", *planes) if name in planes).astype(np.float32)
    try:
        with Image.open(io.BytesIO(data)) as picture:
            whole = picture.mode.startswith("I") or picture.mode == "F"
            codes = np.asarray(picture if whole else picture.convert("RGB"))
    except Image.DecompressionBombError as error:
        raise InputError(path, VAST) from error
    except Exception as error:  # as in read_png
        raise InputError(path, "not an image file, or a corrupt one") from error
    if codes.ndim == 3:
        return codes.astype(np.float32).mean(axis=-1) / np.float32(255)
    return codes.astype(np.float32) / np.float32(65535 if np.issubdtype(codes.dtype, np.integer) else 1)


def write_png(path: str | PathLike[str], image: Float[np.ndarray, "H W C"]) -> None:
    """Write linear RGB (H, W, 3) or premultiplied RGBA (H, W, 4) as `png_bytes`. Raises InputError if `image` has another shape
    or a NaN, or the file cannot be written."""
    replace_file(path, png_bytes(_checked(path, image), path))


def png_bytes(image: Float[np.ndarray, "H W C"], source: str | PathLike[str] = "image") -> bytes:
    """Linear RGB (H, W, 3) or premultiplied RGBA (H, W, 4) as a PNG file: sRGB, 8 bits a channel, straight alpha.

    Colour is clipped to [0, 1] after the division by alpha; where alpha is 0 it is black. Raises InputError, about `source`,
    for a NaN.
    """
    from PIL import Image

    pixels = image.astype(np.float64)
    if np.isnan(pixels).any():
        raise InputError(source, "the image to write has NaN pixels")
    alpha = np.clip(pixels[..., 3:], 0, 1)
    cover = alpha if alpha.size else np.ones_like(pixels[..., :1])
    black = np.zeros_like(pixels[..., :3])
    straight = np.divide(np.clip(pixels[..., :3], 0, cover), cover, out=black, where=cover > 0)
    values = np.concatenate([linear_to_srgb(straight), alpha], axis=-1)
    stream = io.BytesIO()
    Image.fromarray((values * 255 + 0.5).astype(np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


def srgb_codes(x: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    """What a screen is sent for linear values."""
    return np.round(255 * linear_to_srgb(np.clip(x, 0, 1))).astype(np.uint8)


def linear_to_srgb(x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """sRGB encoding v of linear x; the linear segment goes on below 0 and the power above 1 (no clipping)."""
    knee = x.dtype.type(0.0031308)
    return np.where(x <= knee, x * 12.92, 1.055 * np.maximum(x, knee) ** (1 / 2.4) - 0.055)


def srgb_to_linear(v: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Linear x of sRGB-encoded v: the inverse of `linear_to_srgb`."""
    knee = v.dtype.type(0.04045)
    return np.where(v <= knee, v / 12.92, ((np.maximum(v, knee) + 0.055) / 1.055) ** 2.4)


def tonemap(x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """x / (1 + x), the radiance given to networks and losses; x is finite and not negative, the result in [0, 1]."""
    return x / (1 + x)


def _checked(path: str | PathLike[str], image: np.ndarray) -> np.ndarray:
    if image.ndim != 3 or image.shape[2] not in (3, 4) or 0 in image.shape:
        raise InputError(path, f"cannot write an image of shape {image.shape}; expected (H, W, 3) or (H, W, 4)")
    return image


def _exr_planes(path: str | PathLike[str], data: bytes) -> dict[str, np.ndarray]:
    import OpenEXR

    with silent():
        try:
            with OpenEXR.File(io.BytesIO(data), separate_channels=True) as file:
                return {name: np.array(channel.pixels) for name, channel in file.channels().items()}
        except Exception as error:  # RuntimeError, ValueError, UnicodeDecodeError, MemoryError, …
            raise InputError(path, "corrupt or truncated OpenEXR file") from error
