"""What several materials in one picture cost: python -m benchmarks.several_materials

A cow of fur on a hill of grass (docs/how_to/several_materials.md), passes of one ray a pixel at 256², draft; medians of passes
that take turns. `both` over the sum of the two with the other bare; and grass on both meshes, decoded by one program, and by
two of which each sample chooses because their ages differ by nothing that is seen: what the choice costs, the floor being 1.
"""

import time
from dataclasses import replace

import numpy as np

import mesoshell as ms
from mesoshell.render.quality import PRESETS
from mesoshell.scene.picture import Passes
from mesoshell.scene.prepare import prepare

COW, HILL, SIZE, TURNS = "src/mesoshell/assets/spot.obj", "experiments/scenes/hill.obj", (256, 256), 7
CAMERA = (2.2, 0.7, -3.2, 0.0, -0.2, 0.0, 36.0)


def scenes() -> dict[str, ms.Scene]:
    """By name, of one camera and its lights."""
    fur, turf = ms.load_material("pelt"), ms.load_material("turf")
    cow = ms.Scene(COW, fur, camera=CAMERA, size=SIZE, lights=[(0.3, 1.0, -0.5)])
    hill = replace(cow, mesh=HILL, material=turf, scale=0.35)
    same = replace(cow, material=turf, thickness=0.06, scale=0.2, params={"age": 0.5})
    shared = ms.Grown(HILL, turf, thickness=0.06, scale=0.2, params={"age": 0.5})
    return {
        "fur, bare hill": replace(cow, objects=[HILL]),
        "grass, bare cow": replace(hill, objects=[COW]),
        "both": replace(cow, also=[ms.Grown(HILL, turf, scale=0.35)]),
        "grass on both": replace(same, also=[shared]),
        "grass on both, apart": replace(same, also=[replace(shared, params={"age": 0.5001})]),
    }


def main() -> None:
    every = np.arange(SIZE[0] * SIZE[1])
    passes: dict[str, Passes] = {}
    for name, scene in scenes().items():
        passes[name] = prepare(scene, PRESETS["draft"]).passes(None)
        passes[name].render(0, every, lambda share: None)
    seconds: dict[str, list[float]] = {name: [] for name in passes}
    for turn in range(1, TURNS + 1):
        for name, one in passes.items():
            begin = time.perf_counter()
            image = one.render(turn, every, lambda share: None)
            seconds[name].append(time.perf_counter() - begin)
            if turn == TURNS:
                queries = one.ended(image, turn).record["queries"] / (turn + 1)
                print(f"{name:28}{np.median(seconds[name]):7.2f} s a pass{queries / 1e6:8.2f} M queries")
    t = {name: float(np.median(x)) for name, x in seconds.items()}
    alone = t["fur, bare hill"] + t["grass, bare cow"]
    print(f"both over the sum of each with the other bare: {t['both'] / alone:.2f}")
    print(f"apart over together: {t['grass on both, apart'] / t['grass on both']:.2f}")


if __name__ == "__main__":
    main()
