"""`mesoshell judge scores`: a table of measures, a material a column. Imports JAX.

Notation
renders     one half of the dataset compared with the other: no material can be told from renders below that
limit       what a generated material should reach; a ratio is to the renders' own
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from mesoshell.cli.checks import at_least
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.judged_material import bundle_of, posed_material
from mesoshell.cli.options.judge import Scores
from mesoshell.cli.progress import say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.io.dataset import read_dataset
from mesoshell.io.image import write_png
from mesoshell.io.names import distinct_names
from mesoshell.io.sheet import tiled
from mesoshell.io.whole import probe_outputs, replace_file, together
from mesoshell.measure import fields
from mesoshell.measure.copies import among
from mesoshell.measure.features import Extractor, extractor, unseen
from mesoshell.measure.scores import halves, judge_of, renders, score
from mesoshell.measure.sliced import SIDE

LIMITS = {"repeat": "0.2", "comb, lean": "20", "comb, strokes": "20", "nearest exemplar": "as renders"}
#: Of generated patches, those shown beside their nearest exemplars.
SHOWN = 12


def run(options: Scores) -> None:
    """Write scores.json, scores.md and pictures; print the table."""
    at_least(options, images=4)
    bundles = {name: bundle_of(name) for name in options.materials}
    exemplars = [bundle_of(name) for name in options.exemplars]
    for name, bundle in zip(options.exemplars, exemplars, strict=True):
        if bundle.generator is not None or not bundle.wraps:
            raise InputError(name, "is no fitted patch: an exemplar is one that repeats")
    dataset = read_dataset(options.data)
    if min(dataset.samples[0].size) < SIDE:
        raise InputError(
            dataset.folder, f"has pictures of fewer than {SIDE} pixels a side, which have no patches to compare"
        )
    table = options.out / "scores.md"
    probe_outputs([options.out / "scores.json", table])
    a, b = halves(dataset, options.images)
    keep_compiled()
    posed = {name: posed_material(name, dataset) for name in bundles}
    console = stderr()
    with console.status(f"{len(a)} renders beside {len(b)} others"):
        judge = judge_of(dataset, a, _networks(console))
        known = np.concatenate([fields.patches(x, "exemplar") for x in exemplars]) if exemplars else None
        columns: dict[str, dict[str, Any]] = {
            "renders": {k: e._asdict() for k, e in score(judge, b, renders(dataset, b)).items()}
        }
        if known is not None and len(known) > 1:
            columns["renders"] |= _distances([row.distance for row in among(known, known.shape[2:])])
    with together(table) as folder:
        for (name, material), label in zip(posed.items(), distinct_names(list(posed)), strict=True):
            with console.status(f"{name}: {len(b)} pictures"):
                column = {k: e._asdict() for k, e in score(judge, b, material.pictures(b, 0)).items()}
            with console.status(f"{name}: a field from above"):
                columns[name] = column | _over_a_field(bundles[name], name, label, known, folder)
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
    """The network that no discriminator saw first, if its weights are there."""
    try:
        return [unseen(), extractor()]
    except InputError as error:
        say_notes(console, [error])
        return [extractor()]


def _over_a_field(
    bundle: Bundle, name: str, label: str, known: np.ndarray | None, folder: Path
) -> dict[str, dict[str, float]]:
    """Scores of a texture alone, and its pictures in `folder`, named by `label`. Three planes a patch make no texture."""
    if bundle.generator is not None and bundle.generator.get("planes", 1) > 1:
        return {}
    field = fields.seen_from_above(bundle, name)
    write_png(folder / f"field_{label}.png", field)
    found = {"repeat": {"value": fields.repeat(field)}}
    if known is not None:
        made = fields.patches(bundle, name)
        nearest = fields.copied(made, known)
        found |= _distances([row.distance for row in nearest])
        theirs = [np.roll(known[row.exemplar], np.negative(row.shift), (1, 2)) for row in nearest]
        pairs = [_depth(x) for pair in zip(made[:SHOWN], theirs, strict=False) for x in pair]
        write_png(folder / f"nearest_{label}.png", tiled(np.stack(pairs), 8))
    if fields.combs(bundle):
        off = fields.combed(bundle, name)
        found |= {"comb, lean": {"value": off.lean}, "comb, strokes": {"value": off.strokes}}
    return found


def _distances(d: list[float]) -> dict[str, dict[str, float]]:
    """Median, with the least and the greatest as its range."""
    return {"nearest exemplar": {"value": float(np.median(d)), "low": min(d), "high": max(d)}}


def _depth(opacity: np.ndarray) -> np.ndarray:
    """Expected height of what is seen first from above, grey."""
    clear = np.cumprod(1 - opacity[::-1], axis=0)
    seen = np.concatenate([np.ones_like(clear[:1]), clear[:-1]]) * opacity[::-1]
    height = (np.arange(len(opacity))[::-1, None, None] + 0.5) / len(opacity)
    return np.repeat((seen * height).sum(axis=0)[..., None], 3, axis=2).astype(np.float32)
