"""Is a large texture of a trained generator everywhere what it was trained on? python -m benchmarks.endless RUN [--images 200]

Of the run's newest snapshot, printed as a table:

    repeat          largest normalised autocorrelation of 12 × 12 patches at lags of more than a patch      at most 0.2
    moments         of each feature within the texture's inner patches, over those of as many training crops of the same w:
                    difference of the means in standard deviations, and ratio of the deviations, the median feature's
                    within 5%
    KID             of pictures of patches in the middle of a plane, over that of pictures of training crops, both against
                    the renders                                                                         at most 1.1
    EQ-T            of the trained weights                                                              at least 45 dB
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.io.bundle import read_bundle
from mesoshell.io.dataset import read_dataset
from mesoshell.measure.distribution import kid
from mesoshell.measure.equivariance import eq_t
from mesoshell.measure.features import extractor
from mesoshell.measure.repetition import largest_repeat
from mesoshell.shell.generator.generator import draw_phases, synthesise
from mesoshell.shell.generator.model import GeneratorModel, generator_model, grown
from mesoshell.shell.generator.plan import CELL
from mesoshell.train.gan.curriculum import adapt, views_of
from mesoshell.train.gan.snapshot import pictures
from mesoshell.train.gan.state import GanConfig, Learner
from mesoshell.train.run_config import read_record, snapshots

PATCHES, TILE, BATCH = 12, 4, 20
#: Cells from the origin to a patch in the middle of the texture.
INSIDE = (5 * CELL, 6 * CELL)


def textures(maker: GeneratorModel, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """12 × 12 patches of seed 0, and training crops of the same w with phases of their own."""
    side, config = maker.config.texels, maker.config
    w, phases = grown(maker, 0, beta)

    def made(size: int):
        return jax.jit(
            lambda maker, averages, w, phases, tile: synthesise(config, maker, averages, w, phases, tile, (size, size))
        )

    large, small = made(TILE * side), made(side)
    rows = []
    for v in range(0, PATCHES, TILE):
        corners = [jnp.array([v * CELL, u * CELL], jnp.int32) for u in range(0, PATCHES, TILE)]
        parts = [large(maker.generator, maker.averages, w, phases, c).feature[0] for c in corners]
        rows.append(np.concatenate([np.asarray(p) for p in parts], axis=1))
    crops = []
    for k in range(64):
        own = draw_phases(config, jax.random.key(1000 + k), 1)
        crops.append(np.asarray(small(maker.generator, maker.averages, w, own, jnp.zeros(2, jnp.int32)).feature[0]))
    return np.concatenate(rows), np.stack(crops)


def moments(large: np.ndarray, crops: np.ndarray, side: int) -> tuple[float, float]:
    inner = large[2 * side : -2 * side, 2 * side : -2 * side].astype(np.float64)
    mean, deviation = crops.mean(axis=(0, 1, 2), dtype=np.float64), crops.std(axis=(0, 1, 2), dtype=np.float64)
    drift = np.abs(inner.mean(axis=(0, 1)) - mean) / deviation
    return float(np.median(drift)), float(np.median(inner.std(axis=(0, 1)) / deviation))


def features(
    config: GanConfig, maker: GeneratorModel, dataset, count: int, tile: tuple[int, int] | None, network
) -> np.ndarray:
    """Of renders, or of pictures of a tile from their cameras."""
    positions = np.random.default_rng(0).permutation(len(dataset.samples))[:count]
    views = views_of(config, dataset, positions)
    if tile is None:
        return network.of(views.image)
    learner = Learner(maker.generator, maker.decoder)
    parts = []
    for i in range(0, count, BATCH):
        some = jax.tree.map(lambda x, i=i: x[i : i + BATCH], views)
        parts.append(pictures(config, learner, maker.averages, some, tile))
    return network.of(np.concatenate(parts))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--images", type=int, default=200, help="pictures of each kind; a multiple of 20")
    options = parser.parse_args()
    config, data = read_record(options.run)
    images, path = snapshots(options.run)[-1]
    maker = generator_model(read_bundle(path), str(path))
    print(f"{path}, {images / 1000:g} kimg\n\n| | measured | asked |\n|---|---|---|")
    beta = np.full(maker.config.betas, 0.5, np.float32)
    large, crops = textures(maker, beta)
    value, lag = largest_repeat(large, maker.config.texels)
    patches = ", ".join(f"{x / maker.config.texels:.1f}" for x in lag)
    print(f"| repeat | {value:.3f} at {patches} patches | ≤ 0.2 |")
    drift, ratio = moments(large, crops, maker.config.texels)
    print(f"| moments | means {drift:.3f} σ apart, σ {ratio:.3f} | within 5% |")
    w, phases = grown(maker, 0, beta)
    found = eq_t(maker.config, (maker.generator, maker.averages), w, phases, (5.0, 9.0))
    print(f"| EQ-T | {found:.1f} dB | ≥ 45 dB |", flush=True)
    dataset, network = read_dataset(Path(data["folder"])), extractor()
    assert isinstance(config, GanConfig)
    config, dataset = adapt(config, dataset)
    real, crop, inside = (
        features(config, maker, dataset, options.images, tile, network) for tile in (None, (0, 0), INSIDE)
    )
    at_crop, at_inside = kid(real, crop), kid(real, inside)
    print(f"| KID-EffLite0 inside / crops | {at_inside:.4f} / {at_crop:.4f} = {at_inside / at_crop:.3f} | ≤ 1.1 |")


if __name__ == "__main__":
    main()
