"""Images from Blender itself: a small set of every recipe, the same bytes twice, and what each parameter touches."""

import json
from pathlib import Path

import numpy as np
import pytest

from data_gen.sample import Drawer
from data_gen.worker import RECIPES
from mesoshell.datasets.blender.process import Blender
from mesoshell.datasets.blender.render import Farm, render_dataset
from mesoshell.datasets.blender.shard import Done, Shard, render_shard
from mesoshell.io.corner_tiles import is_torus
from mesoshell.io.dataset import Sample, read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.dataset_images import load_images
from mesoshell.io.image import read_exr

ROOT = Path(__file__).parents[3]
COUNT, SIZE = 12, 32
pytestmark = pytest.mark.skipif(
    not (ROOT / "data_gen/.venv/installed").exists(), reason="no Blender environment (Python 3.11): make blender"
)


def settings(recipe: str, **own) -> dict:
    shared = {"recipe": recipe, "seed": 3, "size": SIZE, "samples_per_pixel": 4, "denoise": False, "fixed": {}}
    return shared | {"coverage": None, "patch": None, "views": None, "tiles": False} | own


#: The carpet with fewer parameters: the same blades by the same code.
RESTRICTED = ("carpet2", "carpet4", "carpet6", "carpet")
#: Of fur notebooks/datasets.py renders a set, and checks it.
SLOW = (*RESTRICTED, "fur")
EACH = [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in sorted(RECIPES)]


@pytest.fixture(scope="module", params=EACH)
def made(request, tmp_path_factory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp(request.param)
    report = render_dataset(settings(request.param), COUNT, folder, Farm(2, 2), lambda *_: None)
    assert report.faults == [] and len(report.logs) == COUNT
    return request.param, folder


def test_a_set_is_whole_and_shows_the_box_alone(made):
    name, folder = made
    assert check_dataset(folder) == []
    dataset = read_dataset(folder)
    images = load_images(dataset)
    assert (images >= 0).all() and (images[..., 3] <= 1).all()
    assert (images[..., :3] <= 1.001 * RECIPES[name].irradiance).all(), "no pixel outshines the light"
    for sample, image in zip(dataset.samples, images, strict=True):
        assert not image[misses_box(sample)].any(), f"{sample.file} shows something outside the box"
        assert (image[..., 3] > 0.5).any()
    far = [i for i, s in enumerate(dataset.samples) if s.radius > np.median([s.radius for s in dataset.samples])]
    assert all((images[i, 0, :, 3] == 0).all() for i in far if dataset.samples[i].radius > 8), "a far box is surrounded"


def test_a_sample_is_the_same_bytes_alone_and_on_one_thread(made, tmp_path):
    name, folder = made
    (tmp_path / "images").mkdir()
    ((done),) = render_shard(Shard(settings(name), tmp_path, (7,), threads=1))
    assert isinstance(done, Done)
    rows = [json.loads(line) for line in (folder / "samples.jsonl").read_text().splitlines()]
    assert done.row == rows[7]
    assert (tmp_path / "images/000007.exr").read_bytes() == (folder / "images/000007.exr").read_bytes()


def test_a_denoised_sample_is_the_same_bytes_on_any_threads(tmp_path):
    images = []
    for threads in (1, 2):
        folder = tmp_path / str(threads)
        (folder / "images").mkdir(parents=True)
        ((done),) = render_shard(Shard(settings("grass", denoise=True), folder, (7,), threads=threads))
        assert isinstance(done, Done)
        images.append((folder / "images/000007.exr").read_bytes())
    assert images[0] == images[1]


@pytest.mark.parametrize("name", ["grass", pytest.param("fur", marks=pytest.mark.slow), "carpet8"])
def test_appearance_keeps_the_outline_and_geometry_changes_it(name, tmp_path):
    parameters = RECIPES[name].parameters
    rest = {key: parameter.default for key, parameter in parameters.items()}
    with Blender(settings(name, coverage=(0.8, 0.8), samples_per_pixel=1), 2) as blender:

        def image(**values: float) -> np.ndarray:
            answer = blender.render(0, tmp_path / "a.exr", parameters=rest | values)
            assert "fault" not in answer
            return read_exr(tmp_path / "a.exr")

        for key, parameter in parameters.items():
            # half the range: the ends of a hue or of a direction are the same
            low, high = parameter.range
            a, b = image(**{key: low}), image(**{key: 0.5 * (low + high)})
            assert not np.array_equal(a[..., :3], b[..., :3]), f"{key} does nothing"
            same = np.array_equal(a[..., 3], b[..., 3])
            assert same == (parameter.role == "alpha"), f"{key} is said to be {parameter.role}"


def test_what_the_camera_does_not_see_still_casts_its_shadow(tmp_path):
    """A low sun behind the camera would light the box's wall down to its foot, were nothing before it."""
    drawer = Drawer(RECIPES["fur"], 3, (0.8, 0.8), {}, None)
    drawn = ((index, drawer.draw(index)) for index in range(5000))
    index = next(
        index
        for index, sample in drawn
        if sample.light[2] < 0.2
        and sample.camera_to_world[2, 2] < 0.2
        and sample.camera_to_world[:3, 2] @ sample.light > 0.95
        and np.abs(sample.light).max() > 0.95  # along an axis: one wall alone is seen
    )
    values = {"length": 0.95, "value": 0.5, "hue": 0.0, "saturation": 0.0, "roughness": 0.0}
    with Blender(settings("fur", coverage=(0.8, 0.8), samples_per_pixel=16), 2) as blender:
        blender.render(index, tmp_path / "a.exr", parameters=values)
    image = read_exr(tmp_path / "a.exr")
    rows = np.flatnonzero(image[..., 3].mean(axis=1) > 0.4)
    upper, lower = (
        image[part].reshape(-1, 4).sum(axis=0) for part in np.array_split(rows, [len(rows) // 3, -len(rows) // 3])[::2]
    )
    assert lower[1] / lower[3] < 0.1 * upper[1] / upper[3]


@pytest.mark.parametrize(
    ("own", "fault"),
    [
        ({"recipe": "moss"}, "no recipe named moss; there are: carpet, carpet2, carpet4, carpet6, carpet8, fur, grass"),
        ({"fixed": {"age": 1.5}}, "parameter age must lie in 0 to 1, not 1.5"),
        ({"fixed": {"age": float("nan")}}, "parameter age must lie in 0 to 1, not nan"),
        ({"fixed": {"hue": 0.5}}, "grass has no parameter hue; it has age"),
        ({"coverage": (2.0, 0.5)}, "coverage must rise within 0.001 to 2.5: 2.0 0.5"),
        ({"coverage": (0.5, 3.0)}, "coverage must rise within 0.001 to 2.5: 0.5 3.0"),
    ],
)
def test_unusable_settings_are_one_line(own, fault):
    with pytest.raises(ValueError) as caught, Blender(settings(own.pop("recipe", "grass"), **own), 1):
        pass
    assert str(caught.value) == f"dataset: {fault}"


def misses_box(sample: Sample) -> np.ndarray:
    """Pixels (H, W) none of whose neighbours' corners' rays meet the box."""
    width, height = sample.size
    x, y = np.meshgrid(np.arange(-1, width + 2), np.arange(-1, height + 2))
    half = np.tan(sample.fov / 2)
    local = np.stack([(2 * x / width - 1) * half, (1 - 2 * y / height) * half, -np.ones(x.shape)], axis=-1)
    m = sample.camera_to_world
    way = local @ m[:3, :3].T
    with np.errstate(divide="ignore"):
        t0, t1 = (0 - m[:3, 3]) / way, (1 - m[:3, 3]) / way
    hit = np.minimum(t0, t1).max(-1) <= np.maximum(t0, t1).min(-1)
    windows = np.lib.stride_tricks.sliding_window_view(hit, (4, 4))
    return np.logical_not(windows.any(axis=(2, 3)))


def test_corner_tiles_are_rendered_in_turn(tmp_path):
    report = render_dataset(
        settings("grass", tiles=True, coverage=(0.8, 0.8)), 18, tmp_path, Farm(2, 2), lambda *_: None
    )
    assert report.faults == []
    dataset = read_dataset(tmp_path)
    assert is_torus(dataset.manifest["tiles"]) and dataset.manifest["patch"] is None
    assert [dataset.rows[i]["instance"] for i in range(18)] == [*range(16), 0, 1]
    for sample, image in zip(dataset.samples, load_images(dataset), strict=True):
        assert not image[misses_box(sample)].any() and (image[..., 3] > 0.5).mean() > 0.2
