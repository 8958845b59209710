"""A dataset's images: what cannot be trained on is refused when loaded, and `check_dataset` lists every such fault."""

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.dataset_images import load_images

GREY = np.full((4, 6, 4), 0.5, np.float32)


def holed(value: float) -> np.ndarray:
    image = GREY.copy()
    image[1, 2, 3] = value
    return image


BAD_IMAGES = [
    (GREY[:3], "is 6 × 3 pixels; its row says 6 × 4"),
    (GREY.swapaxes(0, 1), "is 4 × 6 pixels; its row says 6 × 4"),
    (GREY[..., :3], "has 3 channels; expected 4 (RGBA)"),
    (holed(np.nan), "has NaN or infinite pixels"),
    (holed(np.inf), "has NaN or infinite pixels"),
]


@pytest.mark.parametrize(("image", "fault"), BAD_IMAGES)
def test_images_that_cannot_be_trained_on(folder, image: np.ndarray, fault: str):
    folder.damage(1, image)
    with pytest.raises(InputError) as caught:
        load_images(read_dataset(folder.path))
    assert str(caught.value) == f"{folder.image(1)}: {fault}"
    assert check_dataset(folder.path) == [f"{folder.image(1)}: {fault}"]


def test_missing_and_unreadable_images(folder):
    folder.image(0).unlink()
    with pytest.raises(InputError) as caught:
        load_images(read_dataset(folder.path))
    assert str(caught.value) == f"{folder.image(0)}: no such file"
    folder.image(1).write_bytes(b"text")
    assert check_dataset(folder.path) == [
        f"{folder.image(0)}: no such file",
        f"{folder.image(1)}: its SHA-256 is not its row's",
        f"{folder.image(1)}: not an OpenEXR file",
    ]


def test_black_images_load_but_are_reported(folder):
    folder.damage(2, GREY * np.array([0, 0, 0, 1], np.float32))
    assert load_images(read_dataset(folder.path))[2, 0, 0].tolist() == [0, 0, 0, 0.5]
    assert check_dataset(folder.path) == [f"{folder.image(2)}: is all black"]


def test_another_image_than_was_rendered(folder):
    folder.sample(0, GREY)
    assert check_dataset(folder.path) == [f"{folder.image(0)}: its SHA-256 is not its row's"]


def test_images_without_a_row_and_rows_that_are_still_to_come(folder):
    folder.write(folder.read_rows()[:2])
    (folder.path / "images/000009.exr.partial").write_bytes(b"")
    assert check_dataset(folder.path) == [
        f"{folder.rows}: has no row for sample 2",
        f"{folder.image(2)}: has no row in samples.jsonl",
        f"{folder.path / 'images/000009.exr.partial'}: has no row in samples.jsonl",
    ]


def test_no_samples(folder):
    folder.write([])
    with pytest.raises(InputError) as caught:
        read_dataset(folder.path)
    assert str(caught.value) == f"{folder.rows}: has no samples"
    assert check_dataset(folder.path)[0] == f"{folder.rows}: has no row for samples 0, 1, 2"


def test_every_fault_is_listed(folder):
    rows = folder.read_rows()
    folder.write([rows[0], rows[1] | {"fov": 0}, rows[2] | {"radius": -1}])
    folder.damage(0, (holed(np.nan) * np.array([0, 0, 0, 1], np.float32))[:2])
    faults = check_dataset(folder.path)
    assert faults == [
        f"{folder.rows}: line 2: fov is 0; expected an angle between 0 and π",
        f"{folder.rows}: line 3: radius is -1; expected a number above 0",
        f"{folder.rows}: has no row for samples 1, 2",
        f"{folder.image(0)}: is 6 × 2 pixels; its row says 6 × 4",
        f"{folder.image(0)}: has NaN or infinite pixels",
        f"{folder.image(0)}: is all black",
        f"{folder.image(1)}: has no row in samples.jsonl",
        f"{folder.image(2)}: has no row in samples.jsonl",
    ]


def test_a_missing_folder_is_its_only_fault(tmp_path):
    assert check_dataset(tmp_path / "none") == [f"{tmp_path / 'none'}: no such folder"]
