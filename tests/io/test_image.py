"""EXR and PNG: what is written comes back, and each fault is one line that names the file."""

import errno
import io
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from mesoshell.errors import InputError
from mesoshell.io.image import linear_to_srgb, read_exr, read_png, srgb_to_linear, tonemap, write_exr, write_png

ONE_FOLDER = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SHAPES = st.tuples(st.integers(1, 6), st.integers(1, 6), st.sampled_from((3, 4)))


def image(channels: int = 4) -> np.ndarray:
    return np.random.default_rng(0).random((5, 7, channels), np.float32)


def exr_of(channels: dict[str, np.ndarray], compression: OpenEXR.Compression = OpenEXR.ZIP_COMPRESSION) -> bytes:
    stream = io.BytesIO()
    OpenEXR.File({"compression": compression, "type": OpenEXR.scanlineimage}, channels).write(stream)
    return stream.getvalue()


def array(values: list, dtype: type = np.float32) -> np.ndarray:
    return np.array(values, dtype)


def fault_of(call, *args) -> str:
    with pytest.raises(InputError) as caught:
        call(*args)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@ONE_FOLDER
@given(pixels=hnp.arrays(np.float16, SHAPES, elements=st.floats(width=16)))
def test_half_values_come_back_exactly(tmp_path: Path, pixels: np.ndarray):
    write_exr(tmp_path / "a.exr", pixels.astype(np.float32))
    back = read_exr(tmp_path / "a.exr")
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, pixels.astype(np.float32))


@ONE_FOLDER
@given(pixels=hnp.arrays(np.float32, SHAPES, elements=st.floats(width=32)))
def test_single_values_come_back_exactly(tmp_path: Path, pixels: np.ndarray):
    write_exr(tmp_path / "a.exr", pixels, half=False)
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), pixels)


def test_half_saturates_finite_values_and_keeps_infinity(tmp_path: Path):
    pixels = array([[[1e6, -1e6, 65504], [np.inf, -np.inf, 65519]]])
    write_exr(tmp_path / "a.exr", pixels)
    expected = array([[[65504, -65504, 65504], [np.inf, -np.inf, 65504]]])
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), expected)


def test_channels_are_found_by_name_among_others_and_of_mixed_types(tmp_path: Path):
    planes: dict[str, np.ndarray] = {
        name: np.full((2, 3), value, np.float32) for name, value in zip("ABGRZ", range(5), strict=True)
    }
    planes["G"] = planes["G"].astype(np.float16)
    (tmp_path / "a.exr").write_bytes(exr_of(planes))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), np.broadcast_to(array([3, 2, 1, 0]), (2, 3, 4)))


def test_other_programs_find_rgba_half_channels(tmp_path: Path):
    write_exr(tmp_path / "a.exr", image())
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        found = {name: channel.pixels.dtype for name, channel in file.channels().items()}
    assert found == dict.fromkeys("ABGR", np.dtype(np.float16))


def test_missing_exr_and_a_folder(tmp_path: Path):
    assert fault_of(read_exr, tmp_path / "a.exr") == f"{tmp_path / 'a.exr'}: no such file"
    assert fault_of(read_exr, tmp_path) == f"{tmp_path}: cannot be read: Is a directory"


@pytest.mark.parametrize("data", [b"", b"v/1", b"hello world" * 9])
def test_not_an_exr(tmp_path: Path, data: bytes):
    (tmp_path / "a.exr").write_bytes(data)
    assert fault_of(read_exr, tmp_path / "a.exr") == f"{tmp_path / 'a.exr'}: not an OpenEXR file"


@pytest.mark.parametrize("names", ["YA", "RG", "Z"])
def test_exr_without_colour(tmp_path: Path, names: str):
    (tmp_path / "a.exr").write_bytes(exr_of({name: np.zeros((2, 2), np.float32) for name in names}))
    found = ", ".join(repr(name) for name in sorted(names))
    assert fault_of(read_exr, tmp_path / "a.exr").endswith(f"has no R, G and B channels (found: {found})")


def test_exr_of_integers(tmp_path: Path):
    (tmp_path / "a.exr").write_bytes(exr_of({name: np.zeros((2, 2), np.uint32) for name in "RGB"}))
    assert fault_of(read_exr, tmp_path / "a.exr").endswith("channel R holds uint32; expected half or float")


def test_subsampled_exr(tmp_path: Path):
    """A 2 × 2 file by hand, since the library writes none: G has a sample at the first pixel alone."""
    whole = exr_of({name: np.zeros((2, 2), np.float32) for name in "RGB"}, OpenEXR.NO_COMPRESSION)
    full, sparse = struct.pack("<2sIIII", b"G", 2, 0, 1, 1), struct.pack("<2sIIII", b"G", 2, 0, 2, 2)
    header = whole[: -2 * (8 + 8 + 24)].replace(full, sparse)
    table = struct.pack("<QQ", len(header) + 16, len(header) + 16 + 28)
    rows = struct.pack("<II20x", 0, 20) + struct.pack("<II16x", 1, 16)
    (tmp_path / "a.exr").write_bytes(header + table + rows)
    assert fault_of(read_exr, tmp_path / "a.exr").endswith("channel G is subsampled; expected full resolution")


def test_a_truncated_exr_is_one_line_and_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture):
    data = exr_of({"RGBA": image()})
    for length in range(4, len(data), 9):
        (tmp_path / "a.exr").write_bytes(data[:length])
        assert fault_of(read_exr, tmp_path / "a.exr").endswith("a.exr: corrupt or truncated OpenEXR file")
    os.write(2, b"open again")
    assert capfd.readouterr() == ("", "open again")


@ONE_FOLDER
@given(where=st.integers(4, 700), value=st.integers(0, 255))
def test_a_damaged_exr_is_an_image_or_an_input_error(tmp_path: Path, where: int, value: int):
    data = bytearray(exr_of({"RGBA": image()}))
    data[where % len(data)] = value
    (tmp_path / "a.exr").write_bytes(data)
    try:
        assert read_exr(tmp_path / "a.exr").dtype == np.float32
    except InputError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("write", [write_exr, write_png])
def test_missing_output_folder(tmp_path: Path, write):
    path = tmp_path / "none" / "a.img"
    assert fault_of(write, path, image()) == f"{path}: cannot be written: its folder does not exist"


@pytest.mark.parametrize("write", [write_exr, write_png])
def test_output_path_that_is_a_folder_leaves_no_partial_file(tmp_path: Path, write):
    (tmp_path / "a.img").mkdir()
    assert fault_of(write, tmp_path / "a.img", image()).endswith("a.img: cannot be written: Is a directory")
    assert [path.name for path in tmp_path.iterdir()] == ["a.img"]


def no_space(handle: int) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("write", [write_exr, write_png])
def test_full_disk_leaves_the_old_file(tmp_path: Path, write, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.img"
    path.write_bytes(b"old")
    monkeypatch.setattr("os.fsync", no_space)
    assert fault_of(write, path, image()) == f"{path}: cannot be written: No space left on device"
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.img", b"old")]


@pytest.mark.parametrize("write", [write_exr, write_png])
def test_unwritable_folder(tmp_path: Path, write, monkeypatch: pytest.MonkeyPatch):
    """Simulated: nothing is forbidden to root, who runs tests in a container."""

    def refuse(path: Path, *_: object):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr("os.open", refuse)
    assert fault_of(write, tmp_path / "a.img", image()) == f"{tmp_path / 'a.img'}: cannot be written: Permission denied"


@pytest.mark.parametrize("write", [write_exr, write_png])
@pytest.mark.parametrize("shape", [(2, 2, 2), (2, 2, 5), (0, 2, 3)])
def test_images_of_other_shapes_are_not_written(tmp_path: Path, write, shape: tuple[int, ...]):
    fault = fault_of(write, tmp_path / "a.img", np.zeros(shape, np.float32))
    assert fault.endswith(f"cannot write an image of shape {shape}; expected (H, W, 3) or (H, W, 4)")


def test_png_holds_straight_srgb(tmp_path: Path):
    half, clear = [0.5 * 0.21404114, 0.5, 2, 0.5], [0.25, 0.25, 0.25, 0]  # sRGB 0.5 is linear 0.21404114
    write_png(tmp_path / "a.png", array([[half, clear, [1, 0, 0.0031308, 1]]]))
    codes = np.asarray(Image.open(tmp_path / "a.png"))
    assert codes.tolist() == [[[128, 255, 255, 128], [0, 0, 0, 0], [255, 0, 10, 255]]]


def test_png_without_alpha_stays_so(tmp_path: Path):
    write_png(tmp_path / "a.png", array([[[-1, 0.21404114, np.inf]]]))
    assert np.asarray(Image.open(tmp_path / "a.png")).tolist() == [[[0, 128, 255]]]


@ONE_FOLDER
@given(codes=hnp.arrays(np.uint8, st.tuples(st.integers(1, 5), st.integers(1, 5), st.just(4))))
def test_png_bytes_survive_a_round_trip(tmp_path: Path, codes: np.ndarray):
    codes[codes[..., 3] == 0] = 0
    Image.fromarray(codes).save(tmp_path / "a.png")
    write_png(tmp_path / "b.png", read_png(tmp_path / "a.png"))
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "b.png")), codes)


def test_png_with_nan_is_not_written(tmp_path: Path):
    fault = fault_of(write_png, tmp_path / "a.png", np.full((1, 1, 3), np.nan, np.float32))
    assert fault == f"{tmp_path / 'a.png'}: the image to write has NaN pixels"
    assert not list(tmp_path.iterdir())


def test_grey_and_palette_png_are_expanded(tmp_path: Path):
    Image.fromarray(array([[255]], np.uint8)).save(tmp_path / "grey.png")
    Image.fromarray(array([[[255, 0, 0]]], np.uint8)).convert("P").save(tmp_path / "palette.png")
    np.testing.assert_allclose(read_png(tmp_path / "grey.png"), [[[1, 1, 1]]], atol=1e-6)
    np.testing.assert_allclose(read_png(tmp_path / "palette.png"), [[[1, 0, 0]]], atol=1e-6)


def test_png_faults(tmp_path: Path):
    path = tmp_path / "a.png"
    assert fault_of(read_png, path) == f"{path}: no such file"
    Image.fromarray(array([[9]], np.uint16)).save(path)
    assert fault_of(read_png, path) == f"{path}: 16-bit grey PNG; expected 8 bits per channel"
    write_png(path, image())
    data = path.read_bytes()
    for bad in (b"", b"text", data[:60], data.replace(b"IDAT", b"JDAT")):
        path.write_bytes(bad)
        assert fault_of(read_png, path) == f"{path}: not a PNG file, or a corrupt one"


def test_png_that_claims_a_huge_size_is_refused(tmp_path: Path):
    header = struct.pack(">IIBBBBB", 1 << 20, 1 << 20, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + header + struct.pack(">I", zlib.crc32(b"IHDR" + header))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    assert fault_of(read_png, tmp_path / "a.png").endswith("not a PNG file, or a corrupt one")


def test_srgb_values():
    x = np.array([-0.01, 0, 0.0031308, 0.21404114048223255, 1, 4])
    v = np.array([-0.1292, 0, 0.04045, 0.5, 1, 1.8248])
    np.testing.assert_allclose(linear_to_srgb(x), v, atol=2e-5)
    np.testing.assert_allclose(srgb_to_linear(v), x, atol=1e-4)


@given(x=hnp.arrays(np.float32, 8, elements=st.floats(-1, 16, width=32)))
def test_srgb_is_undone(x: np.ndarray):
    v = linear_to_srgb(x)
    assert v.dtype == np.float32
    np.testing.assert_allclose(srgb_to_linear(v), x, rtol=1e-5, atol=1e-6)


def test_tonemap_values():
    np.testing.assert_array_equal(tonemap(array([0, 1, 3])), array([0, 0.5, 0.75]))
    assert tonemap(array([3e38]))[0] == 1
