"""Quality of a fit against training minutes: python -m benchmarks.fit DATASET ... --test DATASET [--steps 7000]

Scores the state at steps 125, 250, 500, … and the last, on images that are not trained on; prints a table and draws it.
Minutes are those of training alone.
"""

import argparse
import tempfile
from pathlib import Path

from mesoshell.train.parallel import split_cpu


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
    from mesoshell.train.loop import LOG_EVERY, fit
    from mesoshell.train.rays import image_table, join, ray_table

    from mesoshell.io.dataset import read_dataset
    from mesoshell.train.fit import FitConfig, State
    from mesoshell.train.holdout import score

    config = FitConfig(texels=options.texels, rays=options.rays)
    table, images = join([(ray_table(d), image_table(d)) for d in map(read_dataset, options.datasets)])
    test = read_dataset(options.test)
    due = {options.steps} | {LOG_EVERY * 2**k for k in range(20)}
    found: list[tuple[float, float, float, float, float]] = []
    print("| steps | minutes | foreground | alpha | 4 × 4 blocks | SSIM |\n|---|---|---|---|---|---|")

    def look(row: dict, state: State) -> None:
        if row["step"] not in due:
            return
        s, _ = score(config, state, test)
        found.append((row["minutes"], s.foreground, s.alpha, s.blocks, s.ssim))
        numbers = f"{s.foreground:.1f} | {s.alpha:.1f} | {s.blocks:.1f} | {s.ssim:.2f}"
        print(f"| {row['step']} | {row['minutes']:.1f} | {numbers} |", flush=True)
        if row["step"] == options.steps:
            print(f"\nA constant colour in the true mask: {s.constant:.1f} dB")

    with tempfile.TemporaryDirectory() as run:
        fit(config, table, images, options.steps, Path(run), look)
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
