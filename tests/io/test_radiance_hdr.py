"""Images of Radiance are read as Mitsuba reads them; what is cut off or none is said in a line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.errors import InputError
from mesoshell.io.image import exr_bytes, radiance_of, read_radiance
from mesoshell.io.radiance_hdr import hdr_image
from mesoshell.scene.setup import environment_of

HEAD = b"#?RADIANCE\n# made by hand\nFORMAT=32-bit_rle_rgbe\n\n"


def encoded(pixels: np.ndarray, runs: bool) -> bytes:
    """Bytes (H, W, 4) as a file."""
    height, width = pixels.shape[:2]
    begin = HEAD + f"-Y {height} +X {width}\n".encode()
    if not runs:
        return begin + pixels.tobytes()
    out = [begin]
    for row in pixels:
        out.append(b"\x02\x02" + width.to_bytes(2, "big"))
        for channel in row.T:
            edges = np.flatnonzero(np.diff(channel, prepend=channel[0].astype(int) - 1))
            for first, last in zip(edges, [*edges[1:], width], strict=True):
                for at in range(first, last, 100):
                    n = min(100, last - at)
                    out.append(bytes([128 + n, channel[first]]) if n > 2 else bytes([n, *channel[at : at + n]]))
    return b"".join(out)


def colours(pixels: np.ndarray) -> np.ndarray:
    mantissa, exponent = pixels[..., :3].astype(np.float64), pixels[..., 3:].astype(np.float64)
    return np.where(exponent > 0, np.ldexp(mantissa, exponent.astype(int) - 136), 0).astype(np.float32)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 300), st.booleans(), st.integers(1, 256))
def test_bytes_become_colours(seed: int, height: int, width: int, runs: bool, few: int):
    pixels = np.random.default_rng(seed).integers(0, few, (height, width, 4)).astype(np.uint8)
    runs &= width >= 8
    if not runs and (pixels[0, 0, :2] == 2).all():
        pixels[0, 0, 2] |= 128  # or plain bytes begin as runs do
    np.testing.assert_array_equal(hdr_image(encoded(pixels, runs), "a.hdr"), colours(pixels))


def test_files_are_read_as_mitsuba_reads_them(tmp_path: Path):
    import mesoshell.pathtracer  # noqa: F401  # it chooses the variant
    import mitsuba as mi  # isort: skip

    random = np.random.default_rng(0)
    for shape in ((5, 40, 3), (3, 4, 3), (64, 128, 3)):
        image = (np.exp(random.normal(0, 4, shape)) * (random.random(shape) < 0.9)).astype(np.float32)
        image[: shape[0] // 2, : shape[1] // 2] = 0.25
        mi.Bitmap(image).write(str(tmp_path / "a.hdr"))
        found = read_radiance(tmp_path / "a.hdr")
        np.testing.assert_allclose(found, np.array(mi.Bitmap(str(tmp_path / "a.hdr"))), rtol=1e-6)
        assert (np.abs(found - image) <= image.max(axis=-1, keepdims=True) / 100).all()


def test_exposures_are_divided_out_and_an_exr_is_one_by_its_bytes():
    pixels = np.full((1, 9, 4), [64, 32, 16, 130], np.uint8)
    data = encoded(pixels, True).replace(b"# made", b"EXPOSURE=4.0\nEXPOSURE=0.5\n# made")
    np.testing.assert_allclose(hdr_image(data, "a.hdr"), colours(pixels) / 2)
    image = np.random.default_rng(1).random((4, 8, 3), np.float32)
    np.testing.assert_array_equal(radiance_of(exr_bytes(image, half=False), "b.hdr"), image)


@pytest.mark.parametrize(
    "lines", [b"EXPOSURE=1e-200\nEXPOSURE=1e-200", b"EXPOSURE=-1", b"EXPOSURE=nan", b"EXPOSURE=1e99"]
)
def test_exposures_that_are_none_are_said(lines: bytes):
    data = encoded(np.full((1, 9, 4), 128, np.uint8), True).replace(b"# made by hand", lines)
    with pytest.raises(InputError, match=r"^a\.hdr: has the exposure 'EXPOSURE="):
        hdr_image(data, "a.hdr")


def test_other_files_are_neither():
    with pytest.raises(InputError, match=r"^sky\.png: is neither an OpenEXR file nor one of Radiance"):
        radiance_of(b"\x89PNG", "sky.png")


def test_an_environment_may_be_one(tmp_path: Path):
    (tmp_path / "sky.hdr").write_bytes(encoded(np.full((4, 8, 4), [64, 32, 16, 130], np.uint8), True))
    sky = environment_of(tmp_path / "sky.hdr", 1)
    assert sky is not None and np.isfinite(sky.radiance).all() and sky.radiance.max() > 0


@pytest.mark.parametrize("runs", [False, True])
def test_what_is_cut_off_is_said(runs: bool):
    data = encoded(np.random.default_rng(2).integers(0, 4, (3, 20, 4)).astype(np.uint8), runs)
    hdr_image(data, "a.hdr")
    for end in range(len(data)):
        with pytest.raises(InputError, match=r"^a\.hdr: "):
            hdr_image(data[:end], "a.hdr")


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"#?RADIANCE\n\n-Y 1 +X 1\nabcd", "its header has no line FORMAT=32-bit_rle_rgbe"),
        (HEAD.replace(b"rgbe", b"xyze") + b"-Y 1 +X 1\nabcd", "its header has no line"),
        (HEAD + b"+X 1 -Y 1\nabcd", "has the size and order '\\+X 1 -Y 1'"),
        (HEAD + b"-Y 0 +X 1\n", "1 x 0 has no pixels"),
        (HEAD + b"-Y 9999999 +X 9999999\n", "would take"),
        (HEAD.replace(b"# made by hand", b"EXPOSURE=none") + b"-Y 1 +X 1\nabcd", "has the exposure 'EXPOSURE=none'"),
        (HEAD + b"-Y 1 +X 9\n\x02\x02\x00\x09" + b"\x8a\x01" * 4, "a run does not fit its row"),
        (HEAD + b"-Y 1 +X 9\n\x02\x02\x00\x09" + b"\x00\x01" * 4, "a run does not fit its row"),
        (HEAD + b"-Y 1 +X 9\n\x02\x02\x00\x08" + b"\x89\x01" * 4, "does not begin as the first"),
    ],
)
def test_what_is_none_is_said(data: bytes, fault: str):
    with pytest.raises(InputError, match=f"^a\\.hdr: .*{fault}"):
        hdr_image(data, "a.hdr")
