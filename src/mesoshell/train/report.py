"""report.html of a run: its curves and sheets on one self-contained page.

Notation
log          rows of log.jsonl by kimg: losses, logits if there is a discriminator, images a second
scores       rows of evaluation.jsonl: KID and FID with their intervals, by kimg
"""

import base64
import html
import io
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.io.atomic import replace_file
from mesoshell.io.records import read_rows

SHEETS = 8
#: Columns of a log, by the axis that they are drawn on.
CURVES = {
    "loss": ("generator", "discriminator", "critic", "r1", "penalty"),
    "mean logit": ("real", "fake"),
    "weight of the penalty": ("gamma",),
    "error": ("error", "height", "wanted"),
    "loss of radiance": ("radiance",),
    "loss of transmittance": ("transmittance",),
    "loss of reflectance": ("reflectance",),
    "loss of opacity": ("opacity",),
    "loss of colour": ("render",),
    "loss of mask": ("mask", "facing"),
    "loss of cycle": ("cycle", "chamfer"),
}


def write_report(folder: Path) -> Path:
    """Write folder/report.html from what the folder holds."""
    log, scores, groups = _read(folder)
    parts = [f"<h1>{html.escape(folder.name)}</h1>"]
    if log:
        last = log[-1]
        parts.append(f"<p>{last['kimg']:.1f} kimg; {last['images_per_s']:.2f} images a second at the end.</p>")
        parts += [_curves(log, groups)] if groups else []
    parts += [_scored(rows) for rows in scores]
    sheets = sorted((folder / "sheets").glob("*.png"))
    chosen = (
        [sheets[i] for i in np.unique(np.linspace(0, len(sheets) - 1, SHEETS).round().astype(int))] if sheets else []
    )
    for path in reversed(chosen):
        parts.append(f"<h2>{int(path.stem) / 1000:g} kimg</h2>{_image(path.read_bytes(), path.stem)}")
    style = "body{font:16px sans-serif;max-width:70em;margin:2em auto}img{max-width:100%}td,th{padding:0 1em}"
    page = f"<!doctype html><meta charset=utf-8><title>{html.escape(folder.name)}</title><style>{style}</style>"
    out = folder / "report.html"
    replace_file(out, (page + "\n".join(parts) + "\n").encode())
    return out


def curves(folder: Path) -> bytes | None:
    """A PNG of a run's curves and scores, one above the other; None before there are any."""
    log, scores, groups = _read(folder)
    draw = [partial(_curve, rows=log, label=label, names=names) for label, names in groups.items()]
    draw += [partial(_score, rows=rows) for rows in scores]
    if not draw:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4, 2.4 * len(draw)), layout="constrained")
    for axes, one in zip(figure.subplots(len(draw), squeeze=False)[:, 0], draw, strict=True):
        one(axes)
    return _png(figure)


def _read(folder: Path) -> tuple[list[Any], list[list[Any]], dict[str, tuple[str, ...]]]:
    """Rows of the log, rows of each metric, and which columns of the log, those that are not 0, to draw on which axis."""
    log = read_rows(folder / "log.jsonl", ("kimg", "images_per_s"))
    scores = read_rows(folder / "evaluation.jsonl", ("name", "kimg", "images", "value", "low", "high"))
    groups = {k: tuple(n for n in names if any(row.get(n) for row in log)) for k, names in CURVES.items()}
    drawn = {label: names for label, names in groups.items() if names}
    return log, [[row for row in scores if row["name"] == name] for name in sorted({r["name"] for r in scores})], drawn


def _scored(rows: list[dict[str, Any]]) -> str:
    """Curve and table of one metric."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3), layout="constrained")
    _score(figure.subplots(), rows)
    table = "".join(
        f"<tr><td>{r['kimg']:g}<td>{r['value']:.4g}<td>{r['low']:.4g} to {r['high']:.4g}<td>{r['images']}" for r in rows
    )
    head = "<tr><th>kimg<th>value<th>95% interval<th>images"
    return f"<h2>{html.escape(rows[0]['name'])}</h2>{_image(_png(figure), 'curves')}<table>{head}{table}</table>"


def _curves(rows: list[dict[str, Any]], groups: dict[str, tuple[str, ...]]) -> str:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3), layout="constrained")
    for axes, (label, names) in zip(figure.subplots(1, len(groups), squeeze=False)[0], groups.items(), strict=True):
        _curve(axes, rows, label, names)
    return _image(_png(figure), "curves")


def _score(axes: Any, rows: list[dict[str, Any]]) -> None:
    kimg, value, low, high = (_drawable([row[k] for row in rows]) for k in ("kimg", "value", "low", "high"))
    axes.errorbar(kimg, value, np.maximum((value - low, high - value), 0), marker="o", capsize=3)
    axes.set(xlabel="kimg", ylabel=rows[0]["name"], ylim=(min(0, low.min()), None))


def _curve(axes: Any, rows: list[dict[str, Any]], label: str, names: tuple[str, ...]) -> None:
    kimg = _drawable([row["kimg"] for row in rows])
    for name in names:
        line = {"marker": "."} if len(rows) == 1 else {"linewidth": 0.8}
        axes.plot(kimg, _drawable([row.get(name, np.nan) for row in rows]), label=name, **line)
    axes.set(xlabel="kimg", ylabel=label)
    axes.legend()


def _png(figure: Any) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()


def _image(png: bytes, alt: str) -> str:
    return f'<img alt="{html.escape(alt)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def _drawable(values: list[int | float]) -> np.ndarray:
    """The values, with NaN for numbers too large for an axis, which a diverging run logs."""
    return np.array([float(x) if abs(x) < 1e30 else np.nan for x in values])
