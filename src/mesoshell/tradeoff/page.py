"""report.html: a slider over the front, the front, what each knob buys, and a table; one self-contained page."""

import base64
import html
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from mesoshell.render.quality import PRESETS, SETTINGS
from mesoshell.tradeoff.front import Entry
from mesoshell.tradeoff.knobs import VALUES, changes, describe_changes
from mesoshell.tradeoff.points import Point, picture_path

if TYPE_CHECKING:
    from mesoshell.tradeoff.run import Tradeoff

#: Samples a pixel at which knobs are compared, by whether rays are the same or paths drawn anew, whose noise hides more.
EQUAL = {True: 4, False: 32}
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:72em;margin:2em auto;padding:0 1em;color:#222}
figure{display:inline-block;margin:0 1em 1em 0;vertical-align:top}figcaption{font-size:14px;color:#555}
img.shot{image-rendering:pixelated;width:20em;border-radius:4px}.strip img{image-rendering:pixelated;width:8.5em}
.strip{white-space:nowrap;overflow-x:auto}.strip figure{margin-right:.5em}input[type=range]{flex:1}.ends{display:flex;gap:1em}
table{border-collapse:collapse}td,th{padding:.15em .8em;text-align:right}td:last-child,th:last-child{text-align:left}
tr:nth-child(even){background:#f4f4f4}code{background:#f0f0f0;padding:.1em .3em;overflow-wrap:anywhere}
.plots svg{max-width:100%;height:auto}
p.said{font-size:20px;margin:.3em 0}
"""
_SCRIPT = """
const entries = JSON.parse(document.getElementById('entries').textContent), at = document.getElementById('at');
function show() {
  const e = entries[at.value];
  document.getElementById('picture').src = document.getElementById('p' + at.value).src;
  document.getElementById('map').src = document.getElementById('m' + at.value).src;
  document.getElementById('said').textContent = e.said;
  document.getElementById('how').textContent = e.how;
}
at.addEventListener('input', show); show();
"""


def page(made: "Tradeoff") -> str:
    """The page, as HTML."""
    kept = made.front
    noise, best = made.reference.noise, kept[-1]
    head = f"<!doctype html><html lang=en><meta charset=utf-8><title>What accuracy costs</title><style>{_STYLE}</style>"
    intro = (
        f"{len(made.points)} settings were measured with <i>{html.escape(made.engine)}</i>; {len(kept)} of their pictures are "
        "beaten by no other in both time and error. Error is FLIP, 0 to 1, against a reference "
        f"({made.reference.passes} passes), whose own noise of {noise:.4f} is taken off; below it no error can be measured. "
        f"The least error here is {best.flip:.4f}. From {made.certain:.4f} on the reference is ten times as accurate, in "
        "squared error."
    )
    if best.flip < made.certain:
        intro += " <b>Errors below that are uncertain</b>, and drawn hollow: run longer, in a new folder."
    data = json.dumps([{"said": _summary(e), "how": _how(made, e)} for e in kept]).replace("<", "\\u003c")
    parts = [
        f"<h1>What accuracy costs in time</h1><p>{intro}</p>",
        "<p class=ends><label for=at>fast</label> <input type=range id=at min=0 "
        f'max={len(kept) - 1} value={len(kept) // 2} aria-label="along the front, from fast to accurate"> '
        "<span>accurate</span></p><p class=said id=said></p><p>Render it so: <code id=how></code></p>",
        _figure("picture", "this picture") + _figure("map", "its error, FLIP: black 0, white 1"),
        f"<figure><img class=shot alt=reference src='{_png(made.folder / 'reference.png')}'>"
        "<figcaption>the reference</figcaption></figure>",
        f"<h2>Along the front</h2><div class=strip>{''.join(_pair(made, i, e) for i, e in enumerate(kept))}</div>",
        f"<div class=plots>{_front_plot(made)}</div>",
        f"<h2>What each setting buys</h2><p>One setting changed at a time, beside <code>normal</code>; {_equal(made)} samples "
        "a pixel each. To the left is faster, down is better; the ring is <code>normal</code>; grey bars are quartiles of the "
        "time.</p>"
        f"<div class=plots>{_knob_plots(made)}</div>{_knob_table(made)}",
        f"<h2>The front</h2>{_front_table(made)}",
        "<p>Seconds are those of passes of a sample a pixel, as <code>--budget</code> takes them, at this size on this "
        "machine; a picture whose samples are taken at once may take less. Evaluations are network queries a pixel. All: "
        "points.csv; the front by seconds and by evaluations: front.json.</p>",
        f"<script type=application/json id=entries>{data}</script><script>{_SCRIPT}</script></html>\n",
    ]
    return head + "\n".join(parts)


def _equal(made: "Tradeoff") -> int:
    return EQUAL[made.reference.same_rays]


def _figure(name: str, caption: str) -> str:
    return f"<figure><img class=shot id={name} alt='{caption}'><figcaption>{caption}</figcaption></figure>"


def _summary(e: Entry) -> str:
    low, median, high = e.point.seconds
    spread = (high - low) / 2 / median
    return f"{e.seconds:.2f} s ± {100 * spread:.0f}%, FLIP {e.flip:.4f}: {e.described}"


def _how(made: "Tradeoff", e: Entry) -> str:
    """Options of `mesoshell render`."""
    count = "pixel_samples" if made.reference.same_rays else "spp"
    given = {count: e.samples} | changes(e.point.settings)
    return "--quality normal " + " ".join(f"--set {name}={value}" for name, value in given.items())


def _pair(made: "Tradeoff", i: int, e: Entry) -> str:
    """An entry's picture and error map, from its point's strip."""
    with Image.open(picture_path(made.folder, e.point)) as strip:
        at, width, height = e.point.samples.index(e.samples), strip.width // len(e.point.samples), strip.height // 2
        picture, errors = (
            strip.crop((at * width, y, (at + 1) * width, y + height)).convert("RGB") for y in (0, height)
        )
    shown = "".join(f"<img id={k}{i} alt='' src='{_data(x)}'><br>" for k, x in (("p", picture), ("m", errors)))
    return f"<figure>{shown}<figcaption>{e.seconds:.2f} s, FLIP {e.flip:.3f}</figcaption></figure>"


def _data(picture: Image.Image) -> str:
    file = io.BytesIO()
    picture.save(file, format="png")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()


def _png(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def _front_plot(made: "Tradeoff") -> str:
    """All entries, the front with error bars, and the presets; by seconds, and by evaluations if the engine counts them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    fronts = {"seconds": made.front}
    if all(p.evaluations > 0 for p in made.points):
        fronts["evaluations"] = made.by_evaluations
    for axes, (what, kept) in zip(
        figure.subplots(1, len(fronts), sharey=True, squeeze=False)[0], fronts.items(), strict=True
    ):
        for p in made.points:
            cost = p.seconds[1] if what == "seconds" else p.evaluations
            axes.plot(np.array(p.samples) * cost, p.flip, color="0.85", linewidth=0.8, marker=".", markersize=3)
        x, y = (np.array([getattr(e, k) for e in kept]) for k in (what, "flip"))
        axes.plot(x, y, color="C2", drawstyle="steps-post", linewidth=1.2)
        over = np.array([e.point.spread[e.point.samples.index(e.samples)] for e in kept])
        wide = np.array([[(q - e.point.seconds[1]) * e.samples for q in e.point.seconds[::2]] for e in kept]).T
        bars = np.abs(wide) if what == "seconds" else None
        axes.errorbar(x, y, over, bars, fmt="none", ecolor="C2", elinewidth=1)
        for a, b in zip(x, y, strict=True):
            axes.plot(a, b, "o", color="C2", markerfacecolor="C2" if b >= made.certain else "white", markersize=5)
        for name, marker in (("draft", "v"), ("normal", "s")):
            _preset(axes, made, name, marker, what)
        axes.set(xscale="log", yscale="log", xlabel=f"{what} {'' if what == 'seconds' else 'a pixel'}", ylabel="FLIP")
        axes.grid(color="0.93", which="both")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
        axes.legend(fontsize=9)
    return _svg(figure)


def _preset(axes: Any, made: "Tradeoff", name: str, marker: str, what: str) -> None:
    """A preset with its own number of samples, of which more than were measured follow from bias and noise."""
    point, quality = made.preset(name), PRESETS[name]
    if point is None:
        return
    n = quality.pixel_samples if made.reference.same_rays else quality.spp
    cost = point.seconds[1] if what == "seconds" else point.evaluations
    label = name if n in point.samples else f"{name} (its {n} samples extrapolated)"
    axes.plot(n * cost, point.error(n), marker, color="C3", markersize=7, label=label)


def _knob_plots(made: "Tradeoff") -> str:
    """Time against error of one knob a plot."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator

    alone = {name: points for name in made.names if len(points := _alone(made, name)) > 1}
    base = made.preset("normal")
    if base is None or not alone:
        return ""
    rows = -(-len(alone) // 3)
    figure = Figure(figsize=(12, 3.0 * rows), layout="constrained")
    grid = figure.subplots(rows, 3, squeeze=False).ravel()
    errors = [p.error(_equal(made)) for points in alone.values() for p in points]
    high = max(1.2 * max(errors), 1e-6)
    low = max(0.9 * min(errors), 1e-6 * high)
    times = np.array([p.seconds[::2] for points in alone.values() for p in points]) / base.seconds[1]
    for axes in grid[len(alone) :]:
        axes.axis("off")
    for axes, (name, points) in zip(grid, alone.items(), strict=False):
        x, y = [p.seconds[1] / base.seconds[1] for p in points], [p.error(_equal(made)) for p in points]
        quartiles = np.abs([[q / base.seconds[1] - a for q in p.seconds[::2]] for p, a in zip(points, x, strict=True)])
        axes.errorbar(x, y, xerr=quartiles.T, fmt="o-", color="C0", ecolor="0.7", markersize=4)
        axes.plot(1, base.error(_equal(made)), "o", markersize=10, markerfacecolor="none", color="C3")
        for label, place in _labels([str(p.settings[name]) for p in points], np.log(x), np.log(np.maximum(y, low))):
            axes.annotate(
                label, np.exp(place).tolist(), textcoords="offset points", xytext=(0, 8), ha="center", fontsize=8
            )
        axes.set(title=name, xlabel="time of normal's", ylabel=f"FLIP, {_equal(made)} samples", ylim=(low, high))
        axes.set(xscale="log", xlim=(0.85 * times.min(), 1.2 * times.max()))
        axes.set_xticks([t for t in (0.125, 0.25, 0.5, 1, 2, 4, 8) if times.min() / 2 <= t <= 2 * times.max()])
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.grid(color="0.93")
    return _svg(figure)


def _labels(
    values: list[str], x: Float[np.ndarray, "n"], y: Float[np.ndarray, "n"]
) -> list[tuple[str, Float[np.ndarray, "2"]]]:
    """One label for values that lie in one place, and where."""
    groups: list[list[int]] = []
    for i in range(len(values)):
        near = [g for g in groups if any(abs(x[i] - x[j]) < 0.25 and abs(y[i] - y[j]) < 0.03 for j in g)]
        if near:
            near[0].append(i)
        else:
            groups.append([i])
    return [(", ".join(values[i] for i in g), np.array([x[g].mean(), y[g].max()])) for g in groups]


def _alone(made: "Tradeoff", name: str) -> list[Point]:
    """The points that differ from `normal` in one knob at most, from its cheapest value on."""
    points = [p for p in made.points if changes(p.settings).keys() <= {name}]
    return sorted(points, key=lambda p: VALUES[name].index(p.settings[name]))


def _knob_table(made: "Tradeoff") -> str:
    base = made.preset("normal")
    if base is None:
        return ""
    rows = [
        f"<tr><td>{name}<td>{p.settings[name]}<td>{p.seconds[1] / base.seconds[1]:.2f}<td>{p.evaluations:.1f}"
        f"<td>{p.error(_equal(made)):.4f}<td>{p.bias:.4f}<td>{p.noise:.4f}<td>{SETTINGS[name].bias or 'nothing'}"
        for name in made.names
        for p in _alone(made, name)
        if len(_alone(made, name)) > 1
    ]
    head = "<tr><th>setting<th>value<th>time of normal's<th>evaluations<th>FLIP<th>bias<th>noise of one sample"
    return f"<table>{head}<th>what cheaper values bias</tr>{''.join(rows)}</table>"


def _front_table(made: "Tradeoff") -> str:
    rows = [
        f"<tr><td>{e.seconds:.2f}<td>{e.evaluations:.1f}<td>{e.flip:.4f}<td>{e.point.bias:.4f}"
        f"<td>{e.point.relative[e.point.samples.index(e.samples)]:.3g}<td>{e.samples}"
        f"<td><code>{html.escape(describe_changes(e.point.settings))}</code>"
        for e in made.front
    ]
    head = "<tr><th>seconds<th>evaluations<th>FLIP<th>of it bias<th>relative squared error<th>samples"
    return f"<table>{head}<th>settings, beside normal's</tr>{''.join(rows)}</table>"


def _svg(figure: Any) -> str:
    file = io.StringIO()
    figure.savefig(file, format="svg")
    text = file.getvalue()
    return text[text.index("<svg") :]
