"""Held-out PSNR against training minutes, of runs of `mesoshell atlas train`: python -m benchmarks.atlas RUN ... [--out p.png]

Prints for each run its scores at the end, minutes to 95% of the final PSNR's rise above that of a black picture, rays a second
over the run, and the share of this machine's matrix rate that its steps reach. Scores are those of `mesoshell evaluate`, which
must have been run; minutes are the log's, so runs are to be compared only if each had the machine to itself. `--samples` prints
instead, of each run's newest object, PSNR and seconds a held-out view by samples a ray. `--surface` prints how far from the
mesh that was photographed rays of the held-out views end, on the mean, where they are stopped.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import tyro
from scipy.spatial import KDTree
from trimesh import Trimesh
from trimesh.sample import sample_surface

from benchmarks.rates import matrix_rate
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.image import linear_to_srgb
from mesoshell.measure.flops import count_operations
from mesoshell.measure.image import psnr
from mesoshell.neutex.cameras import photo_rays, pixels
from mesoshell.neutex.capture import Capture
from mesoshell.neutex.render import picture, view
from mesoshell.neutex.store import read_neutex
from mesoshell.render.quality import Quality
from mesoshell.train.neutex import ray_batches
from mesoshell.train.neutex import step as atlas
from mesoshell.train.run_config import read_record, snapshots


@dataclass(frozen=True)
class Options:
    """What to compare."""

    #: Folders of runs.
    runs: tyro.conf.Positional[tuple[Path, ...]]
    #: The plot to write.
    out: Path | None = None
    #: Samples a ray to try.
    samples: tuple[int, ...] = ()
    #: The mesh that was photographed.
    surface: Path | None = None


def main(options: Options) -> None:
    if options.samples:
        print("| run | samples a ray | PSNR | seconds a view |\n|---|---|---|---|")
        for run in options.runs:
            by_samples(run, options.samples)
        return
    if options.surface:
        print("| run | from the mesh, mean, % of the box | 95% within |\n|---|---|---|")
        for run in options.runs:
            from_surface(run, options.surface)
        return
    rate, curves = matrix_rate(), {}
    for run in options.runs:
        config, data = read_record(run)
        assert isinstance(config, atlas.NeuTexTrainConfig)
        config, capture = atlas.adapt(config, ray_batches.recorded_capture(data, config.side))
        rows = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
        log = sorted(
            {row["kimg"]: row for row in rows}.values(), key=lambda row: row["kimg"]
        )  # a killed run says some twice
        scores = [json.loads(line) for line in (run / "evaluation.jsonl").read_text().splitlines()]
        kimg = np.array([row["kimg"] for row in log])
        seconds = np.cumsum(np.diff(kimg, prepend=0) * 1000 / np.array([row["images_per_s"] for row in log]))
        last = {row["name"]: row["value"] for row in scores if row["kimg"] == max(r["kimg"] for r in scores)}
        curve = sorted(
            (float(np.interp(r["kimg"], kimg, seconds)) / 60, r["value"]) for r in scores if r["name"] == "PSNR"
        )
        black = black_psnr(capture)
        enough = next((m for m, v in curve if v - black >= 0.95 * (last["PSNR"] - black)), float("nan"))
        state = jax.eval_shape(lambda config=config: atlas.start(config, jax.random.key(0)))
        work = count_operations(lambda s, b, c=config: atlas.step(c, s, b), state, atlas.feed(config, capture)(0))
        speed = kimg[-1] * 1000 / seconds[-1]
        share = work / config.batch * speed / rate
        print(f"{run.name}: {seconds[-1] / 60:.1f} minutes, {speed:.0f} rays/s, {share:.2f} of the matrix rate")
        print(
            f"    95% after {enough:.1f} minutes; " + ", ".join(f"{name} {value:.4g}" for name, value in last.items())
        )
        curves[run.name] = curve
    if options.out:
        plot(curves, options.out)


def by_samples(run: Path, samples: tuple[int, ...]) -> None:
    config, data = read_record(run)
    assert isinstance(config, atlas.NeuTexTrainConfig)
    _, capture = atlas.adapt(config, ray_batches.recorded_capture(data, config.side))
    found = read_neutex(snapshots(run)[-1][1])
    for n in samples:
        how = view(found.config, found.field, Quality(samples=n, pixel_samples=1))
        errors, seconds = [], []
        for i in ray_batches.held_out(capture)[1]:
            photo = found.to_box(capture.photos[i])
            picture(found.config, found.field, photo, how)
            begin = time.perf_counter()
            shown = picture(found.config, found.field, photo, how).rgba[..., :3]
            seconds.append(time.perf_counter() - begin)
            errors.append(psnr(*(linear_to_srgb(np.clip(x, 0, 1)) for x in (shown, capture.rgb[i]))))
        print(f"| {run.name} | {n} | {np.mean(errors):.2f} | {np.mean(seconds):.2f} |", flush=True)


def from_surface(run: Path, mesh: Path) -> None:
    found = read_neutex(snapshots(run)[-1][1])
    model = load_mesh(mesh)
    near = KDTree(sample_surface(Trimesh(model.vertices, model.faces), 200_000, seed=0)[0])
    how = view(found.config, found.field, Quality(samples=64, pixel_samples=1))
    apart = []
    for photo in (found.photos[i] for i in found.tested):
        shown = picture(found.config, found.field, found.to_box(photo), how)
        o, d = photo_rays(photo, pixels(photo))
        opaque = shown.rgba[..., 3].ravel() > 0.98
        far = shown.depth.ravel()[opaque] / shown.rgba[..., 3].ravel()[opaque] * found.half
        apart.append(near.query(o[opaque] + far[:, None] * d[opaque])[0] / (2 * found.half) * 100)
    apart = np.concatenate(apart)
    print(f"| {run.name} | {apart.mean():.2f} | {np.quantile(apart, 0.95):.2f} |", flush=True)


def black_psnr(capture: Capture) -> float:
    """Of a black picture, the mean over held-out views."""
    views = (linear_to_srgb(np.clip(capture.rgb[i], 0, 1)) for i in ray_batches.held_out(capture)[1])
    return float(np.mean([psnr(view, np.zeros_like(view)) for view in views]))


def plot(curves: dict[str, list[tuple[float, float]]], out: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, curve in curves.items():
        axes.plot(*zip(*curve, strict=True), marker="o", markersize=3, label=name)
    axes.set(xlabel="training minutes", ylabel="held-out PSNR, dB")
    axes.legend()
    figure.savefig(out, dpi=130)


if __name__ == "__main__":
    main(tyro.cli(Options))
