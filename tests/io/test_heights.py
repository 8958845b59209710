"""Heights of image files: numbers as they are stored, whatever the kind of file; each fault is one line."""

import io
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from mesoshell.errors import InputError
from mesoshell.io.image import read_heights, read_png, srgb_to_linear

ONE_FOLDER = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def exr(path: Path, channels: dict[str, np.ndarray], kind: OpenEXR.Storage = OpenEXR.scanlineimage) -> Path:
    stream = io.BytesIO()
    OpenEXR.File({"compression": OpenEXR.ZIPS_COMPRESSION, "type": kind}, channels).write(stream)
    path.write_bytes(stream.getvalue())
    return path


def saved(path: Path, pixels: np.ndarray, mode: str | None = None) -> Path:
    picture = Image.fromarray(pixels)
    (picture.convert(mode) if mode else picture).save(path)
    return path


CODES = np.array([[0, 1, 128], [200, 254, 255]], np.uint8)
WIDE = np.array([[0, 1, 255], [256, 40000, 65535]], np.uint16)


@pytest.mark.parametrize("name", ["a.png", "a.tiff", "a.bmp", "a.gif"])
def test_8_bits_are_shares_of_255(tmp_path: Path, name: str):
    """And no sRGB: a code of 128 is half as high as 255."""
    found = read_heights(saved(tmp_path / name, CODES))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, CODES / 255, rtol=1e-6)
    assert abs(found[0, 2] - srgb_to_linear(found)[0, 2]) > 0.2


@pytest.mark.parametrize("name", ["a.png", "a.tiff"])
def test_16_bits_are_shares_of_65535(tmp_path: Path, name: str):
    found = read_heights(saved(tmp_path / name, WIDE))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, WIDE / 65535, rtol=1e-6)


def test_16_bits_of_the_other_byte_order(tmp_path: Path):
    """A TIFF of 2 × 1 by hand, its numbers with the high byte first."""
    tags = [
        (256, 3, 1, 2 << 16),
        (257, 3, 1, 1 << 16),
        (258, 3, 1, 16 << 16),
        (259, 3, 1, 1 << 16),
        (262, 3, 1, 1 << 16),
    ]
    tags += [(273, 4, 1, 8), (278, 3, 1, 1 << 16), (279, 4, 1, 4)]
    body = bytes.fromhex("0102 ff00")
    entries = b"".join(t.to_bytes(2) + k.to_bytes(2) + n.to_bytes(4) + v.to_bytes(4) for t, k, n, v in tags)
    head = b"MM\x00*" + (12).to_bytes(4) + body
    (tmp_path / "a.tiff").write_bytes(head + len(tags).to_bytes(2) + entries + bytes(4))
    np.testing.assert_allclose(read_heights(tmp_path / "a.tiff"), [[0x0102 / 65535, 0xFF00 / 65535]], rtol=1e-6)


def test_colours_are_their_mean_and_coverage_is_not_looked_at(tmp_path: Path):
    pixels = np.random.default_rng(0).integers(0, 256, (3, 5, 4), np.uint8)
    expected = pixels[..., :3].mean(axis=-1) / 255
    np.testing.assert_allclose(read_heights(saved(tmp_path / "a.png", pixels)), expected, atol=1e-6)
    np.testing.assert_allclose(read_heights(saved(tmp_path / "b.png", pixels[..., :3].copy())), expected, atol=1e-6)


def test_palettes_and_bits_are_expanded(tmp_path: Path):
    board = (np.indices((4, 6)).sum(axis=0) % 2 * 255).astype(np.uint8)
    for mode in ("1", "P", "LA"):
        np.testing.assert_array_equal(read_heights(saved(tmp_path / "a.png", board, mode)), board / 255)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.uint32])
def test_numbers_of_openexr_are_heights(tmp_path: Path, dtype: type):
    heights = np.array([[0, 1, 2], [100, 2000, 7]], dtype)
    found = read_heights(exr(tmp_path / "a.exr", {"Z": heights}))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, heights)


def test_floating_tiff_is_as_stored(tmp_path: Path):
    heights = np.array([[-3.5, 0, 1e6]], np.float32)
    np.testing.assert_array_equal(read_heights(saved(tmp_path / "a.tiff", heights)), heights)


@pytest.mark.parametrize(("names", "first"), [("ABGR", "R"), ("AY", "Y"), ("XZ", "X"), ("BGY", "Y")])
def test_the_channel_that_is_read(tmp_path: Path, names: str, first: str):
    """Red, else luminance, else the first by name."""
    channels: dict[str, np.ndarray] = {name: np.full((2, 2), ord(name), np.float32) for name in names}
    assert (read_heights(exr(tmp_path / "a.exr", channels)) == ord(first)).all()


def test_what_is_not_finite_comes_back_as_it_is(tmp_path: Path):
    heights = np.array([[np.nan, np.inf, -np.inf, 1]], np.float32)
    np.testing.assert_array_equal(read_heights(exr(tmp_path / "a.exr", {"Y": heights})), heights)


def test_deep_openexr_has_no_number_a_pixel(tmp_path: Path, fault_of):
    pixels = np.empty((2, 2), object)
    for i in range(4):
        pixels.flat[i] = np.arange(i + 1, dtype=np.float32)
    exr(tmp_path / "a.exr", {"Z": pixels}, OpenEXR.deepscanline)
    assert fault_of(read_heights, tmp_path / "a.exr") == "has no channel with one number a pixel"


def test_a_missing_file_and_a_folder(tmp_path: Path, fault_of):
    assert fault_of(read_heights, tmp_path / "a.png") == "no such file"
    assert fault_of(read_heights, tmp_path) == "cannot be read: Is a directory"


@pytest.mark.parametrize("data", [b"", b"hello world", b"\x89PNG\r\n\x1a\n", b"v/1", b"<svg></svg>"])
def test_what_is_no_image(tmp_path: Path, fault_of, data: bytes):
    (tmp_path / "a.png").write_bytes(data)
    assert fault_of(read_heights, tmp_path / "a.png") == "not an image file, or a corrupt one"


def test_what_is_cut_off(tmp_path: Path, fault_of, capfd: pytest.CaptureFixture):
    rough = np.random.default_rng(0).integers(0, 65536, (16, 16)).astype(np.uint16)
    for path, fault in (
        (saved(tmp_path / "a.png", rough), "not an image file, or a corrupt one"),
        (exr(tmp_path / "a.exr", {"Y": rough.astype(np.float32)}), "corrupt or truncated OpenEXR file"),
    ):
        whole = path.read_bytes()
        for length in range(9, len(whole) - 20, 41):
            path.write_bytes(whole[:length])
            assert fault_of(read_heights, path) == fault
    assert capfd.readouterr() == ("", "")


@ONE_FOLDER
@given(where=st.integers(0, 400), value=st.integers(0, 255), name=st.sampled_from(["a.png", "a.tiff", "a.exr"]))
def test_a_damaged_file_is_heights_or_one_line(tmp_path: Path, fault_of, where: int, value: int, name: str):
    path = tmp_path / name
    exr(path, {"Y": WIDE.astype(np.float32)}) if name == "a.exr" else saved(path, WIDE)
    data = bytearray(path.read_bytes())
    data[where % len(data)] = value
    path.write_bytes(data)
    try:
        found = read_heights(path)
    except ValueError:
        fault_of(read_heights, path)
    else:
        assert found.dtype == np.float32 and found.ndim == 2


def test_an_image_of_too_many_pixels_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    Image.new("L", (40, 40)).save(tmp_path / "a.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 700)
    for read in (read_heights, read_png):
        with pytest.raises(InputError, match="has more pixels than are read"):
            read(tmp_path / "a.png")
