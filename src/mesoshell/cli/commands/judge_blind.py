"""`mesoshell judge blind` and `marks`. The latter imports no JAX."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from mesoshell.cli.options.judge import Blind, Marks
from mesoshell.errors import InputError
from mesoshell.io.atomic import move_together, probe_outputs, read_file, replace_file
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_images import load_images
from mesoshell.io.image import write_png
from mesoshell.io.records import read_object
from mesoshell.measure.blind import draw_sheet, letters, marks, score_judge, shuffle_pictures


def make_sheet(options: Blind) -> None:
    """Write sheet.png and answers.json."""
    from mesoshell.cli.compilation_cache import keep_compiled
    from mesoshell.cli.judged_material import pose_named

    if not 0 <= options.seed < 2**32:
        raise InputError("--seed", f"{options.seed} must be from 0 to 4294967295")
    dataset = read_dataset(options.data)
    if not 1 <= options.count <= len(dataset.samples):
        raise InputError("--count", f"{options.count} must be from 1 to the dataset's {len(dataset.samples)} images")
    files = [options.out / "answers.json", options.out / "sheet.png"]
    probe_outputs(files)
    chosen = np.random.default_rng(options.seed).choice(len(dataset.samples), options.count, replace=False)
    samples = [dataset.samples[i] for i in chosen]
    keep_compiled()
    made = pose_named(options.material, dataset).pictures(samples, options.seed)
    if options.against is None:
        real = load_images(replace(dataset, samples=tuple(samples)))
    else:
        real = pose_named(options.against, dataset).pictures(samples, options.seed)
    sheet = shuffle_pictures(real, made, options.seed)
    answers = {
        "made": options.material,
        "real": options.against or str(options.data),
        "data": str(options.data),
        "seed": options.seed,
        "side": real.shape[1],
        "samples": [samples[i].index for i in sheet.pose],
        "answer": letters(sheet.answer),
    }
    with move_together(files[1]) as folder:
        replace_file(folder / "answers.json", (json.dumps(answers, indent=1) + "\n").encode())
        write_png(folder / "sheet.png", draw_sheet(sheet))
    print(files[1])


def count_marks(options: Marks) -> None:
    """Print a table, a judge a row, and write it as judged.json beside the sheet."""
    if not options.marks:
        raise InputError("MARKS", "give a file of marks for each judge")
    path = options.sheet / "answers.json"
    stored = read_object(path).get("answer")
    answer = _marks(path, stored) if isinstance(stored, str) else np.zeros(0, bool)
    if not len(answer):
        raise InputError(path, "holds no answers to a blind sheet")
    rows = {}
    for file in options.marks:
        given = _marks(file, read_file(file).decode(errors="replace"))
        if len(given) != len(answer):
            raise InputError(file, f"has {len(given)} marks; the sheet has {len(answer)} pictures")
        rows[str(file)] = score_judge(answer, given)
    print("| judge | right | share | 95% | by chance |\n|---|---|---|---|---|")
    for name, j in rows.items():
        print(f"| {name} | {j.right} of {j.count} | {j.share:.0%} | {j.low:.0%} to {j.high:.0%} | {j.chance:.2g} |")
    print(f"| mean | | {np.mean([j.share for j in rows.values()]):.0%} | | |")
    text = json.dumps({name: j._asdict() for name, j in rows.items()}, indent=1)
    replace_file(options.sheet / "judged.json", (text + "\n").encode())


def _marks(path: Path, text: str) -> np.ndarray:
    try:
        return marks(text)
    except ValueError as error:
        raise InputError(path, str(error)) from None
