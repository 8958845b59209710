"""`mesoshell judge scores`: a table of measures, a material a column. Imports JAX.
The column `renders` compares one half of the dataset with the other: the noise floor of each score.
"""

import json
from typing import Any

import numpy as np
from rich.console import Console

from mesoshell.cli.checks import at_least
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.judged_material import bundle_of, pose_named
from mesoshell.cli.options.judge import Scores
from mesoshell.cli.progress import say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import move_together, probe_outputs, replace_file
from mesoshell.io.dataset import read_dataset
from mesoshell.io.image import write_png
from mesoshell.io.names import distinct_names
from mesoshell.measure import fields
from mesoshell.measure.copies import among
from mesoshell.measure.features import Extractor, efficientnet_lite2, extractor
from mesoshell.measure.scores import halves, judge_of, renders, score, shares
from mesoshell.measure.sliced import SIDE

#: What a generated material should reach.
LIMITS = {
    "opacity": "0.95 to 1.05",
    "repeat": "0.2",
    "comb, lean": "20",
    "comb, strokes": "20",
    "nearest exemplar": "as renders",
}


def run(options: Scores) -> None:
    """Write scores.json, scores.md and pictures; print the table."""
    at_least(options, images=4)
    bundles = {name: bundle_of(name) for name in options.materials}
    exemplars = [bundle_of(name) for name in options.exemplars]
    for name, bundle in zip(options.exemplars, exemplars, strict=True):
        if bundle.generator is not None or not bundle.wraps or bundle.tiles is not None:
            raise InputError(name, "is no fitted patch: an exemplar must be one patch that repeats")
    dataset = read_dataset(options.data)
    if min(dataset.samples[0].size) < SIDE:
        raise InputError(dataset.folder, f"has pictures of fewer than {SIDE} pixels a side: too few to compare")
    table = options.out / "scores.md"
    probe_outputs([options.out / "scores.json", table])
    a, b = halves(dataset, options.images)
    keep_compiled()
    posed = {name: pose_named(name, dataset) for name in bundles}
    console = stderr()
    with console.status(f"{len(a)} renders beside {len(b)} others"):
        judge = judge_of(dataset, a, _networks(console))
        known = np.concatenate([fields.patches(x, "exemplar") for x in exemplars]) if exemplars else None
        real = renders(dataset, b)
        columns: dict[str, dict[str, Any]] = {"renders": {k: e._asdict() for k, e in score(judge, b, real).items()}}
        if known is not None and len(known) > 1:
            columns["renders"] |= fields.distances(among(known, known.shape[2:]))
    with move_together(table) as folder:
        for (name, material), label in zip(posed.items(), distinct_names(list(posed)), strict=True):
            with console.status(f"{name}: {len(b)} pictures"):
                made = material.pictures(b, 0)
                column = {k: e._asdict() for k, e in (score(judge, b, made) | shares(real, made)).items()}
            with console.status(f"{name}: a field from above"):
                texture, pictures = fields.score(bundles[name], name, known)
            columns[name] = column | texture
            for kind, picture in pictures.items():
                write_png(folder / f"{kind}_{label}.png", picture)
        record = {"data": str(options.data), "images": len(a), "scores": columns}
        replace_file(folder / "scores.json", (json.dumps(record, indent=1) + "\n").encode())
        text = f"{len(a)} pictures a side, of {options.data}; 95% intervals\n\n{as_table(columns)}"
        replace_file(folder / "scores.md", text.encode())
    print(text, end="")


def as_table(columns: dict[str, dict[str, Any]]) -> str:
    """Markdown: a score a row, a source a column."""
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    lines = ["| | " + " | ".join(columns) + " | limit |", "|---" * (len(columns) + 2) + "|"]
    for name in names:
        cells = [_cell(column.get(name)) for column in columns.values()]
        limit = "1.5 × renders" if name.startswith("read ") else LIMITS.get(name, "")
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {limit} |")
    return "\n".join(lines) + "\n"


def _cell(x: dict[str, float] | None) -> str:
    if x is None:
        return ""
    return f"{x['value']:.3g} ({x['low']:.3g} to {x['high']:.3g})" if "low" in x else f"{x['value']:.3g}"


def _networks(console: Console) -> list[Extractor]:
    """EfficientNet-Lite2 first, if its weights are installed, since no discriminator was trained with it; then Lite0."""
    try:
        return [efficientnet_lite2(), extractor()]
    except InputError as error:
        say_notes(console, [error])
        return [extractor()]
