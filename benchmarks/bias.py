"""What noise in queries does to a loss in logarithms: python -m benchmarks.bias [weave spheres ...]

Queries that are asked again and again come back as x̂ with their opacity α. What is learned from them is where the loss is
least, log(1 + x) = Σ α log(1 + x̂) / Σ α, and lies below their mean Σ α x̂ / Σ α. Prints by how much, in per cent of the mean
over queries, for each mesostructure and number of light paths a query: at the finest footprints, and at all.
"""

import argparse

import numpy as np

from mesoshell.mesostructure.render import FINEST, REACH, Settings, questions
from mesoshell.mesostructure.sources import PROCEDURES, source
from mesoshell.mesostructure.tile import Placing
from mesoshell.mesostructure.trace import Patch, queries

SPP, QUERIES, REPEATS, CURVATURES = (4, 8, 16, 32), 2048, 32, (-0.5, 0.0, 1.0)


def bias(name: str, spp: int) -> tuple[float, float]:
    """Of what is learned, relative; at the finest footprints, and at all."""
    tile = source(name)
    asked = questions(Settings(name, tile.depth, (-1.0, 2.0), QUERIES, spp, 0), np.random.default_rng(0))
    fine = asked["radius"] <= FINEST
    learned, mean = [], []
    for curvature in CURVATURES:
        placing = Placing(curvature)
        patch = Patch(tile, placing, REACH)
        found = [queries(patch, placing, asked, spp, seed) for seed in range(REPEATS)]
        alpha = np.stack([f["alpha"] for f in found])
        x = np.pi * np.stack([f["reflectance"] for f in found]) / np.maximum(alpha, 1e-3)
        weight = alpha / np.maximum(alpha.sum(axis=0), 1e-9)
        learned.append(np.expm1((weight * np.log1p(x)).sum(axis=0)))
        mean.append((weight * x).sum(axis=0))
    a, b = np.stack(learned), np.stack(mean)
    return float(a[:, fine].mean() / b[:, fine].mean() - 1), float(a.mean() / b.mean() - 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(PROCEDURES))
    asked = parser.parse_args()
    print("| light paths a query | " + " | ".join(asked.names) + " |\n" + "|---" * (len(asked.names) + 1) + "|")
    for spp in SPP:
        found = [bias(name, spp) for name in asked.names]
        print(f"| {spp} | " + " | ".join(f"{a:+.1%}, {b:+.1%}" for a, b in found) + " |", flush=True)


if __name__ == "__main__":
    main()
