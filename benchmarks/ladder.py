"""What a march's settings bias and how noisy they are: python -m benchmarks.ladder FOLDER [--picture FILE]

Measures each rung of mesoshell.scene.choose on the four marches of benchmarks.presets, whose references FOLDER keeps, and
prints the numbers of LADDER: geometric means of bias and noise over the noise of the first rung, and of its queries; PAIR;
FALL; and how far scenes lie apart. A bias that is not above the noise of the reference is unknown and left out. With --picture:
the strip of docs/how_to/time_and_error. Whether goals are reached: benchmarks.goals.

Notation
b, ν, q, e(n), p    as in mesoshell.scene.choose; e(n) is of the first n passes: FLIP against the reference, less its noise
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

import mesoshell as ms
from benchmarks.presets import MARCHED, NORMAL, SPOT, place
from mesoshell.io.atomic import replace_file
from mesoshell.io.image import write_png
from mesoshell.measure.flip import POWER, flip
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.scene.choose import LADDER
from mesoshell.scene.picture import Passes
from mesoshell.scene.prepare import prepare
from mesoshell.tradeoff.knobs import describe_changes
from mesoshell.tradeoff.reference import Reference

#: Passes whose mean is compared; seconds after which three are enough; how far above the reference's noise a bias is known.
COUNTS, ENOUGH_SECONDS, KNOWN = (1, 3, 5, 9, 17), 90.0, 1.1
CLOSE, SHOWN, BUDGETS = (1.5, 0.9, -2.4, 0, 0.05, 0.15, 40), 256, (1.0, 4.0, 16.0, 60.0)


class Measured(NamedTuple):
    """Of a rung and a scene: FLIP by n; queries of a ray; noise of the reference; FLIP of one pass against two."""

    errors: dict[int, float]
    queries: float
    reference: float
    pair: float


def measure(folder: Path) -> dict[str, list[Measured]]:
    """Each scene's, a rung each: what FOLDER has, or anew."""
    file, found = folder / "ladder.json", {}
    kept: dict[str, dict[str, Any]] = json.loads(file.read_text()) if file.exists() else {}
    for name, (material, mesh, scale, camera, side) in MARCHED.items():
        scene = ms.Scene(mesh, ms.load_material(material), scale=scale, camera=camera, size=(side, side))
        here = place(name, prepare(scene, NORMAL), folder)
        for rung in LADDER:
            own = kept.setdefault(name, {})
            if (key := describe_changes(rung.settings)) not in own:
                one = taken(here.prepared.passes(NORMAL.with_changes(**rung.settings)), here.reference)
                own[key] = one._asdict()
                replace_file(file, (json.dumps(kept, indent=1) + "\n").encode())
            one = Measured(**own[key])
            one = one._replace(errors={int(n): e for n, e in one.errors.items()})
            found.setdefault(name, []).append(one)
            errors = ", ".join(f"{n} {e:.4f}" for n, e in one.errors.items())
            print(f"{name:18}{one.queries:7.1f}  {errors}  {describe_changes(rung.settings)}", flush=True)
    return found


def taken(passes: Passes, reference: Reference) -> Measured:
    true = over_backdrop(reference.image)
    passes.compile()
    pixels, begin = np.arange(passes.shape[0] * passes.shape[1]), time.perf_counter()
    total, first, pair, errors = 0.0, np.empty(0), 0.0, {}
    for k in range(COUNTS[-1]):
        total = total + passes.render(k, pixels, lambda share: None).reshape(*passes.shape, 4)
        mean = over_backdrop(total / (k + 1))
        if k == 0:
            first = mean
        if k == 1:
            pair = flip(first, mean)
        if k + 1 in COUNTS:
            errors[k + 1] = flip(mean, true)
            if len(errors) > 2 and time.perf_counter() - begin > ENOUGH_SECONDS:
                break
    record = passes.ended(np.zeros((*passes.shape, 4), np.float32), 2).record
    return Measured(errors, record["queries"] / max(record["rays"], 1), reference.noise, pair)


def fitted(one: Measured, fall: float) -> tuple[float, float, float]:
    """b, ν, and the root of the mean square of relative residuals."""
    n, e = np.array(list(one.errors)), np.array(list(one.errors.values()))
    e = np.maximum(e**POWER - one.reference**POWER, (0.3 * e) ** POWER) ** (1 / POWER)
    scale = e**-POWER
    fit, rest = nnls(np.stack([scale, scale / n**fall], axis=1), np.ones(len(e)), maxiter=1000)
    return float(fit[0] ** (1 / POWER)), float(fit[1] ** (1 / POWER)), rest / len(e) ** 0.5


def report(found: dict[str, list[Measured]]) -> None:
    falls = np.arange(0.9, 1.7, 0.05)
    misses = [np.mean([fitted(one, f)[2] for some in found.values() for one in some]) for f in falls]
    fall = float(falls[np.argmin(misses)])
    print(f"\nFALL {fall:.2f} (residual {min(misses):.3f}; of 1: {misses[int(np.argmin(abs(falls - 1)))]:.3f})")
    print("| settings | bias | noise | queries | bias of each scene |\n|---|---|---|---|---|")
    first = [(fitted(some[0], fall)[1], some[0].queries) for some in found.values()]
    for k, rung in enumerate(LADDER):
        rows = []
        for (nu, queries), some in zip(first, found.values(), strict=True):
            b, noise, _ = fitted(some[k], fall)
            known = b > KNOWN * some[k].reference
            rows.append((b / nu if known else np.nan, noise / nu, some[k].queries / queries))
        bias, *rest = np.array(rows).T
        columns = (bias[~np.isnan(bias)], *rest)
        means = [f"{np.exp(np.log(np.maximum(x, 1e-4)).mean()):.3f}" if len(x) else "" for x in columns]
        cells = [describe_changes(rung.settings), *means, ", ".join(f"{x:.2f}" for x in bias)]
        print(f"| {' | '.join(cells)} |")
    shares = [some[0].pair / nu for (nu, _), some in zip(first, found.values(), strict=True)]
    print(f"PAIR {np.exp(np.log(shares).mean()):.3f} ({', '.join(f'{x:.2f}' for x in shares)})")


def picture(path: Path) -> None:
    """The same view after each budget, written as a strip."""
    shown = ms.Scene(SPOT, ms.load_material("grass"), size=(SHOWN, SHOWN), camera=CLOSE)
    views = [ms.render(shown, budget=seconds) for seconds in BUDGETS]
    for view in views:
        print(view.report["goal"])
    write_png(path, np.concatenate([view.rgba for view in views], axis=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--picture", type=Path, help="write a strip of pictures")
    given = parser.parse_args()
    if given.picture:
        picture(given.picture)
        return
    given.folder.mkdir(parents=True, exist_ok=True)
    report(measure(given.folder))


if __name__ == "__main__":
    main()
