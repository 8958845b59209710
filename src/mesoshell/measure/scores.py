"""Scores of a set of pictures against renders: distances, and how well parameters can be read off them.

Notation
A, B        halves of a dataset; where it has many views of a patch, they share no patch
floor       scores of B's renders against A's: the scores of a perfect material
made        scores of pictures from B's cameras, with B's lights and parameters, against A's renders
read        error of a reader that learned from A, over the parameter's range
share       total opacity, or light, of made pictures over that of B's renders

Floor and made are measured alike, so that they compare. Shares compare pictures from the same cameras.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, Sample
from mesoshell.io.dataset_images import load_images
from mesoshell.measure.distribution import Estimate, kid, with_interval
from mesoshell.measure.features import Extractor, to_display
from mesoshell.measure.reader import Reader, error, learn, read
from mesoshell.measure.sliced import descriptors, swd


class Judge(NamedTuple):
    """What is computed from A: features by each network, descriptors of each level, and a reader of its parameters."""

    networks: list[Extractor]
    features: list[Float[np.ndarray, "N D"]]
    levels: list[Float[np.ndarray, "N _D"]]
    reader: Reader
    parameters: dict[str, tuple[float, float]]


def halves(dataset: Dataset, images: int, seed: int = 0) -> tuple[list[Sample], list[Sample]]:
    """A and B, of the same size, at most `images`. Raises InputError for fewer than four."""
    rng = np.random.default_rng(seed)
    groups: dict[int, list[Sample]] = {}
    for sample in dataset.samples:
        groups.setdefault(int(dataset.rows.get(sample.index, {}).get("instance", sample.index)), []).append(sample)
    if len(groups) < 2:  # one patch alone
        groups = {sample.index: [sample] for sample in dataset.samples}
    order = rng.permutation(sorted(groups))
    parts = [[s for k in keys for s in groups[int(k)]] for keys in (order[::2], order[1::2])]
    count = min(images, *map(len, parts))
    if count < 4:
        raise InputError(dataset.folder, "has too few images to compare: halves of 4 are the least")
    a, b = ([part[i] for i in rng.permutation(len(part))[:count]] for part in parts)
    return a, b


def judge_of(dataset: Dataset, a: list[Sample], networks: list[Extractor]) -> Judge:
    """The judge from the renders of A. The reader sees the first network's features."""
    images = renders(dataset, a)
    features = [network.of(images) for network in networks]
    declared, fixed = dataset.manifest["parameters"], dataset.manifest.get("fixed_parameters", {})
    known = {k: (float(x["range"][0]), float(x["range"][1])) for k, x in declared.items() if k not in fixed}
    return Judge(
        networks,
        features,
        descriptors(to_display(images)),
        learn(_reader_inputs(features[0], images), _values(known, a)),
        known,
    )


def renders(dataset: Dataset, samples: list[Sample]) -> Float[np.ndarray, "N H W 4"]:
    """The rendered images of samples, linear premultiplied."""
    return load_images(replace(dataset, samples=tuple(samples)))


def score(judge: Judge, b: list[Sample], images: Float[np.ndarray, "N H W 4"]) -> dict[str, Estimate]:
    """Scores of pictures from B's cameras."""
    features = [network.of(images) for network in judge.networks]
    rows = {
        f"KID-{network.name}": with_interval(kid, real, made)
        for network, real, made in zip(judge.networks, judge.features, features, strict=True)
    }
    levels = descriptors(to_display(images), seed=1)
    sides = [images.shape[1] >> i for i in range(len(levels))]
    for side, real, made in zip(sides, judge.levels, levels, strict=True):
        rows[f"SWD-{side}"] = with_interval(swd, real, made)
    true, read_values = _values(judge.parameters, b), read(judge.reader, _reader_inputs(features[0], images))
    for i, name in enumerate(judge.parameters):
        rows[f"read {name}"] = _with_interval(lambda k, i=i: float(error(read_values[k], true[k])[i]), len(b))
    return rows


def shares(
    real: Float[np.ndarray, "N H W 4"], images: Float[np.ndarray, "N H W 4"], seed: int = 0
) -> dict[str, Estimate]:
    """Opacity and light of pictures over those of renders from the same cameras. Over black a gap is as dark as a blade in
    shadow, so other scores hardly see that opacity is missing."""
    of = {"opacity": lambda x: x[..., 3], "light": lambda x: x[..., :3].mean(axis=-1)}
    sums = {k: [f(x).sum(axis=(1, 2), dtype=np.float64) for x in (images, real)] for k, f in of.items()}
    return {
        name: _with_interval(
            lambda k, made=made, true=true: float(made[k].sum() / max(true[k].sum(), 1e-9)), len(real), seed
        )
        for name, (made, true) in sums.items()
    }


def _reader_inputs(
    features: Float[np.ndarray, "N D"], images: Float[np.ndarray, "N H W 4"]
) -> Float[np.ndarray, "N _D"]:
    """Features, and the mean colour over its sum, repeated to the features' length. Colour halves the error of the age of
    grass; without the repetition, ridge regression would give 3 numbers beside 1280 hardly any weight."""
    colour = images[..., :3].mean(axis=(1, 2), dtype=np.float64)
    hue = colour / np.maximum(colour.sum(axis=1, keepdims=True), 1e-9)
    return np.concatenate([features, np.tile(hue, (1, -(-features.shape[1] // 3)))], axis=1)


def _values(parameters: dict[str, tuple[float, float]], samples: list[Sample]) -> Float[np.ndarray, "N P"]:
    """Parameters, normalised."""
    columns = [[(s.parameters[name] - low) / (high - low) for s in samples] for name, (low, high) in parameters.items()]
    return np.array(columns, np.float64).reshape(len(parameters), len(samples)).T


def _with_interval(of: Callable[[np.ndarray], float], count: int, seed: int = 0) -> Estimate:
    """A value with its interval by 200 bootstraps."""
    rng = np.random.default_rng(seed)
    reach = 1.96 * float(np.std([of(rng.integers(0, count, count)) for _ in range(200)], ddof=1))
    value = of(np.arange(count))
    return Estimate(value, value - reach, value + reach)
