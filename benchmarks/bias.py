"""What noise in queries does to what is learned from them: python -m benchmarks.bias [weave spheres ...]

Queries that are asked again and again come back as x̂ with their opacity α. What is learned is the x at which their loss is
least, Σ α ((log(1 + x) − log(1 + x̂))² + 0.1 |x − x̂|) (train/surface/step), and not their mean Σ α x̂ / Σ α. Prints by how much
it is off, in per cent of the mean over queries, for each mesostructure and number of light paths a query: at the finest
footprints, and at all.
"""

import argparse

import numpy as np

from mesoshell.datasets.queries.render import FINEST, REACH, Settings, questions
from mesoshell.datasets.queries.sources import PROCEDURES, source
from mesoshell.datasets.queries.tile import PatchPlacement
from mesoshell.datasets.queries.trace import Patch, queries

SPP, QUERIES, REPEATS, CURVATURES = (4, 8, 16, 32), 2048, 32, (-0.5, 0.0, 1.0)
#: Places between the least and the greatest x̂ at which the loss is looked at.
PLACES = 129


def bias(name: str, spp: int) -> tuple[float, float]:
    """Of what is learned, relative; at the finest footprints, and at all."""
    tile = source(name)
    asked = questions(Settings("", 0.0, (0.0, 0.0), QUERIES, 1, 0), np.random.default_rng(0))
    fine = asked["radius"] <= FINEST
    learned, mean = [], []
    for curvature in CURVATURES:
        placing = PatchPlacement(curvature)
        patch = Patch(tile, placing, REACH)
        found = [queries(patch, placing, asked, spp, seed) for seed in range(REPEATS)]
        alpha = np.stack([f["alpha"] for f in found])
        x = np.pi * np.stack([f["reflectance"] for f in found]) / np.maximum(alpha, 1e-3)
        weight = alpha / np.maximum(alpha.sum(axis=0), 1e-9)
        learned.append(best(x, weight))
        mean.append((weight * x).sum(axis=0))
    a, b = np.stack(learned), np.stack(mean)
    return float(a[:, fine].mean() / b[:, fine].mean() - 1), float(a.mean() / b.mean() - 1)


def best(x: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Where the loss over the first axis is least."""
    low, high = x.min(axis=0), x.max(axis=0)
    least, at = np.full(low.shape, np.inf), low
    for share in np.linspace(0, 1, PLACES):
        here = low + share * (high - low)
        loss = (weight * ((np.log1p(here) - np.log1p(x)) ** 2 + 0.1 * np.abs(here - x))).sum(axis=0)
        at = np.where(loss < least, here, at)
        least = np.minimum(loss, least)
    return at


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
