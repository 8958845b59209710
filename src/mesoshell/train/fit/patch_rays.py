"""Pictures of patches as rays: the patch that each shows, the pixels whose rays meet the unit box, and the rows of a step.

Notation
K, N        patches, and pictures of all of them; the 16 tiles of a torus are patches, in their order on it
patch       a geometry: a recipe at a version, an instance, and its β; datasets that share it add pictures to it
pixel       index among the pixels of all pictures, row by row; picture n begins at first[n]
held        held-out pictures: the last ones of a patch, in every dataset
y           x / (1 + x) of a pixel's radiance x, and its alpha                   (4,)

A ray's origin and direction are in the frame of the unit box, which is its patch. Rays that miss the box are left out: they are
black in data and model alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float16, Int

from mesoshell.errors import InputError
from mesoshell.io.corner_tiles import SIDE, is_torus
from mesoshell.io.dataset import Dataset, Sample, origin, parameter_table
from mesoshell.io.dataset_images import load_image
from mesoshell.io.image import HALF_MAX
from mesoshell.limits import check_memory
from mesoshell.render.camera import Camera, pixel_grid, pixel_radius, rays

#: A pixel's memory while pictures are gathered: its colour twice, its number, its patch.
BYTES = 40


class Rays(NamedTuple):
    """A row of a step: rays of one patch. NumPy on the host, JAX in a step, where rows have one axis more.

    patch: which; key: of the row's random numbers."""

    patch: Any  # ()
    origin: Any  # (R, 3)
    direction: Any  # (R, 3)
    radius: Any  # (R,), of the cone at distance 1
    light: Any  # (R, 3)
    irradiance: Any  # (R, 3)
    alpha: Any  # (R, A)
    target: Any  # (R, 4), y
    key: Any  # (2,), uint32


@dataclass(frozen=True, eq=False)
class FitData:
    """Pictures of K patches. learned, held: pixels of each patch that meet the box; beta: geometry parameters of
    each, mapped to [0, 1] by their ranges. manifest: the first dataset's; origins: of all. tiles: patches along the side of the
    torus whose tiles these are, or 0. given: decoder and height feature of another fit, by their names in a bundle."""

    folder: Path
    recipe: str
    manifest: dict[str, Any]
    samples: tuple[Sample, ...]
    first: Int[np.ndarray, "_n"]
    pixels: Float16[np.ndarray, "P 4"]
    learned: tuple[Int[np.ndarray, "_"], ...]
    held: tuple[Int[np.ndarray, "_"], ...]
    beta: Float[np.ndarray, "K G"]
    alpha: Float[np.ndarray, "N A"]
    origins: tuple[dict[str, Any], ...]
    tiles: int = 0
    given: dict[str, np.ndarray] | None = None

    def target(self, pixels: Int[np.ndarray, "R"]) -> Float[np.ndarray, "R 4"]:
        """y."""
        colour = self.pixels[pixels].astype(np.float32)
        return np.concatenate([colour[:, :3] / (1 + colour[:, :3]), colour[:, 3:]], axis=1)


def gather_fit_data(datasets: Sequence[Dataset], held: int = 0, tests: Sequence[Dataset] = ()) -> FitData:
    """Datasets of the same patches together. held: how many pictures of each patch, in each dataset, are held out; tests:
    datasets that are held out as a whole.

    Raises InputError if a picture shows a geometry of its own, datasets have other parameters than the first, or a patch has
    no pictures left to learn from."""
    for test in tests:
        if test.folder.resolve() in {d.folder.resolve() for d in datasets}:
            raise InputError(test.folder, "is learned from: it cannot test what was learned")
    datasets = [*datasets, *tests]
    parameters = _parameters(datasets)
    keys = [(_geometry(d, s), d, s) for d in datasets for s in d.samples]
    tiled = _tiled(datasets, {key for key, _, _ in keys})
    order = sorted if tiled else list
    patches = {key: i for i, key in enumerate(order(dict.fromkeys(key for key, _, _ in keys)))}
    for dataset in datasets:
        _check_fixed(dataset, {key for key, d, _ in keys if d is dataset})
    samples = tuple(s for _, _, s in keys)
    of = np.array([patches[key] for key, _, _ in keys])
    out = np.concatenate([_held(of[[d is e for _, e, _ in keys]], 10**9 if d in tests else held) for d in datasets])
    sizes = np.array([s.size[0] * s.size[1] for s in samples])
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    check_memory(datasets[0].folder, f"{len(samples)} pictures", BYTES * int(first[-1]))
    pixels, met = _pixels(samples, first)
    which, left_out = np.repeat(of, sizes)[met], np.repeat(out, sizes)[met]
    hits = np.flatnonzero(met)
    learned, kept = (
        tuple(hits[(which == k) & (left_out == side)] for k in range(len(patches))) for side in (False, True)
    )
    if min(map(len, learned)) == 0:
        raise InputError(datasets[0].folder, "has a patch whose pictures are all held out: none is left to learn from")
    beta, alpha = (parameter_table(parameters, samples, role) for role in ("beta", "alpha"))
    origins = tuple(origin(d) for d in datasets if d not in tests)
    manifest = datasets[0].manifest | {"source": origins}
    where = [int(np.flatnonzero(of == k)[0]) for k in range(len(patches))]
    return FitData(
        datasets[0].folder,
        datasets[0].recipe,
        manifest,
        samples,
        first,
        pixels,
        learned,
        kept,
        beta[where],
        alpha,
        origins,
        SIDE if tiled else 0,
    )


def _parameters(datasets: Sequence[Dataset]) -> dict[str, Any]:
    """The parameters of all datasets. Raises InputError if one has another recipe or other parameters than the first."""
    recipe, parameters = datasets[0].recipe, datasets[0].manifest["parameters"]
    for dataset in datasets:
        if dataset.recipe != recipe or dataset.manifest["parameters"] != parameters:
            raise InputError(dataset.folder, "has another recipe or other parameters than the first dataset")
    return parameters


def _tiled(datasets: Sequence[Dataset], geometries: set[tuple]) -> bool:
    """Whether these are pictures of corner tiles. Raises InputError if some are not, or tiles are missing."""
    first = datasets[0].manifest.get("tiles")
    for dataset in datasets:
        if dataset.manifest.get("tiles") != first:
            raise InputError(dataset.folder, "has other tiles than the first dataset")
    if first is not None and not is_torus(first):
        raise InputError(datasets[0].folder, "its tiles are not the colours of a torus of 4 x 4 tiles")
    if first is not None and {g[0] for g in geometries} != set(range(SIDE**2)):
        there = len({g[0] for g in geometries})
        raise InputError(
            datasets[0].folder, f"shows {there} of the {SIDE**2} tiles: give it a --count of {SIDE**2} or more"
        )
    if first is not None and len(geometries) > SIDE**2:
        fault = "has tiles of other geometry parameters, or of another version, than other datasets or pictures"
        raise InputError(datasets[-1].folder, fault)
    return first is not None


def _check_fixed(dataset: Dataset, geometries: set[tuple]) -> None:
    """Raise InputError if a dataset of one patch has several geometries: its geometry parameters vary."""
    if dataset.manifest.get("patch", 0) is None or len(geometries) == 1:
        return
    names = [n for n, p in dataset.manifest["parameters"].items() if p["role"] == "beta"]
    free = [n for i, n in enumerate(names) if len({g[2 + i] for g in geometries}) > 1]
    fault = f"its geometry varies with {', '.join(free)}; fix it with --param {free[0]}=VALUE"
    raise InputError(dataset.folder, fault)


def _pixels(
    samples: Sequence[Sample], first: Int[np.ndarray, "_n"]
) -> tuple[Float16[np.ndarray, "P 4"], Bool[np.ndarray, "P"]]:
    """All pixels, and whether their rays meet the box."""
    pixels, met = np.empty((first[-1], 4), np.float16), np.empty(first[-1], bool)
    for i, sample in enumerate(samples):
        at = slice(first[i], first[i + 1])
        pixels[at] = np.minimum(load_image(sample), HALF_MAX).reshape(-1, 4)
        near, far = box_span(*_pixel_rays(sample))
        met[at] = far > near + 1e-6
    return pixels, met


def _geometry(dataset: Dataset, sample: Sample) -> tuple:
    """What identifies a patch: its number among many, or the seed of a single one; version; and β. Raises InputError if every
    picture has its own geometry."""
    manifest = dataset.manifest
    patch = manifest.get("patch", 0)
    if patch is None and "views" not in manifest and "tiles" not in manifest:
        raise InputError(
            dataset.folder, "every image shows another geometry; render it with --patch 0, --patches 16 or --tiles"
        )
    instance = patch if patch is not None else dataset.rows[sample.index].get("instance")
    beta = [n for n, p in manifest["parameters"].items() if p["role"] == "beta"]
    return instance, manifest["version"], *(sample.parameters[n] for n in beta)


def _held(patch: Int[np.ndarray, "N"], held: int) -> np.ndarray:
    """Which pictures of a dataset are held out: the last of each patch."""
    out = np.zeros(len(patch), bool)
    for k in np.unique(patch):
        out[np.flatnonzero(patch == k)[::-1][:held]] = True
    return out


def _pixel_rays(sample: Sample) -> tuple[np.ndarray, np.ndarray]:
    width, height = sample.size
    fov = 2 * np.arctan(height / width * np.tan(sample.fov / 2))
    camera = Camera(sample.camera_to_world, fov, width, height)
    return rays(camera, pixel_grid(camera, 1, 0))


def box_span(
    o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"]
) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R"]]:
    """Distances at which rays enter and leave the unit box; for a ray that misses, the second is less than the first."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort(np.stack([-o / d, (1 - o) / d]), axis=0)
    return np.max(np.fmax(ends[0], 0), axis=1), np.min(ends[1], axis=1)


def rays_at(data: FitData, pixels: Int[np.ndarray, "R"], patch: int, key: np.ndarray) -> Rays:
    """The rays of some pixels, all of one patch."""
    n = np.searchsorted(data.first, pixels, side="right") - 1
    which, back = np.unique(n, return_inverse=True)
    some = [data.samples[i] for i in which]
    width = np.array([s.size[0] for s in some])[back]
    height = np.array([s.size[1] for s in some])[back]
    spread = np.array([2 * np.tan(s.fov / 2) / s.size[0] for s in some])[back]
    y, x = np.divmod(pixels - data.first[n], width)
    local = np.stack([(x + 0.5 - width / 2) * spread, (height / 2 - y - 0.5) * spread, -np.ones(len(x))], axis=1)
    frame = np.array([s.camera_to_world for s in some])[back]
    d = np.einsum("rij,rj->ri", frame[:, :3, :3], local)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    light, irradiance = (np.array([getattr(s, name) for s in some])[back] for name in ("light", "irradiance"))
    columns = frame[:, :3, 3], d, pixel_radius(1.0) * spread, light, irradiance, data.alpha[n], data.target(pixels)
    return Rays(np.int32(patch), *(np.ascontiguousarray(c, np.float32) for c in columns), key=key)
