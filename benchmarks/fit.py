"""Quality of a fit against training minutes: python -m benchmarks.fit DATASET ... --test DATASET [--steps 7000]

Scores the state at steps 125, 250, 500, … and the last, on images that are not trained on; prints a table and draws it.
Minutes are those of training alone.
"""

import argparse
import tempfile
from pathlib import Path

from mesoshell.train.parallel import split_cpu

#: Steps between snapshots.
KEPT = 125


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--test", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=7000)
    parser.add_argument("--rays", type=int, default=1024)
    parser.add_argument("--texels", type=int, default=128)
    parser.add_argument("--out", type=Path, default=Path("docs/images/fit_minutes.png"))
    options = parser.parse_args()
    split_cpu()
    from mesoshell.io.dataset import read_dataset
    from mesoshell.io.exemplars import read_exemplars
    from mesoshell.io.records import read_rows
    from mesoshell.train.fit.feed import adapt
    from mesoshell.train.fit.holdout import score
    from mesoshell.train.fit.patch_rays import gather_fit_data
    from mesoshell.train.fit.state import FitConfig, given
    from mesoshell.train.malloc import keep_memory
    from mesoshell.train.run import train
    from mesoshell.train.run_config import snapshots

    keep_memory()
    data = gather_fit_data([read_dataset(d) for d in options.datasets], tests=[read_dataset(options.test)])
    config = FitConfig(texels=options.texels, rays=options.rays // 8, steps=options.steps, kept=KEPT)
    due = {options.steps} | {KEPT * 2**k for k in range(20)}
    found: list[tuple[float, float, float, float, float]] = []
    print("| steps | minutes | foreground | alpha | 4 × 4 blocks | SSIM |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as run:
        train(config, data, Path(run))
        config, data = adapt(config, data)
        rows, seconds, minutes = read_rows(Path(run) / "log.jsonl", ("kimg", "images_per_s")), 0.0, {}
        for before, row in zip([{"kimg": 0.0}, *rows], rows, strict=False):
            seconds += 1000 * (row["kimg"] - before["kimg"]) / row["images_per_s"]
            minutes[round(1000 * row["kimg"])] = seconds / 60
        for images, path in snapshots(Path(run)):
            if images // config.batch not in due:
                continue
            patch = given(read_exemplars(path))
            s, _ = score(config, data, patch, options.test)
            spent = min((at for at in minutes if at >= images), default=max(minutes))
            found.append((minutes[spent], s.foreground, s.alpha, s.blocks, s.ssim))
            numbers = f"{s.foreground:.1f} | {s.alpha:.1f} | {s.blocks:.1f} | {s.ssim:.2f}"
            print(f"| {images // config.batch} | {minutes[spent]:.1f} | {numbers} |", flush=True)
    print(f"\nA constant colour in the true mask: {s.constant:.1f} dB")
    draw(found, options.out)


def draw(found: list[tuple[float, float, float, float, float]], out: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
    minutes, foreground, alpha, blocks, ssim = zip(*found, strict=True)
    for values, name in ((blocks, "4 × 4 blocks"), (alpha, "alpha"), (foreground, "foreground")):
        left.plot(minutes, values, marker="o", label=name)
    right.plot(minutes, ssim, marker="o", color="black")
    left.set_ylabel("PSNR, dB")
    right.set_ylabel("SSIM")
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_xlabel("training minutes")
        axes.grid(alpha=0.3)
    left.legend()
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main()
