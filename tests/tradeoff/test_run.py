"""A tradeoff measures, keeps and goes on, with a made-up engine whose bias and cost are known."""

import csv
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.io.image import read_png
from mesoshell.measure.flip import flip
from mesoshell.render.quality import Quality
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.scene.picture import Passes, Prepared, Rendered
from mesoshell.tradeoff import page, run
from mesoshell.tradeoff.knobs import changes, settings_of
from mesoshell.tradeoff.points import Point, picture_path
from mesoshell.tradeoff.reference import Reference, render_reference
from tests.helpers import made_passes

NAMES = ("samples", "anisotropy")


def prepare(quality: Quality, engine: str = "made", shift: float = 0.0) -> Prepared:
    """An engine that knows two knobs: samples bias, anisotropy takes noise away."""

    def passes(other: Quality | None) -> Passes:
        q = other or quality
        made = made_passes.passes(0.5 / q.samples + shift, 0.04 / q.anisotropy, queries=q.samples)

        def ended(image: np.ndarray, samples: int) -> Rendered:
            rendered = made.ended(image, samples)
            return rendered._replace(record=rendered.record | {"quality": settings_of(q, NAMES)})

        return made._replace(ended=ended)

    return Prepared(engine, {}, None, ("a note",), 0.0, 0.0, lambda progress: None, passes)  # type: ignore[arg-type]


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine points, and a reference of few passes, however long they take."""
    monkeypatch.setattr(run, "MAX_POINTS", 9)
    monkeypatch.setattr(run, "AIM", 0.01)


def explored(folder: Path, **how) -> run.Tradeoff:
    return run.explore(lambda q: prepare(q, **how), (), folder, 60.0, lambda share, what: None)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[run.Tradeoff, Path]:
    """A tradeoff of nine points, and its folder."""
    folder = tmp_path_factory.mktemp("first")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "MAX_POINTS", 9)
        patch.setattr(run, "AIM", 0.01)
        return explored(folder), folder


@pytest.fixture
def folder(first: tuple[run.Tradeoff, Path], tmp_path: Path) -> Path:
    """A copy that may be changed."""
    return Path(shutil.copytree(first[1], tmp_path / "copy"))


def test_what_is_measured_is_written(first: tuple[run.Tradeoff, Path]) -> None:
    made, tmp_path = first
    assert made.names == NAMES and len(made.points) == 9 and made.notes == ("a note",)
    assert [changes(p.settings) for p in made.points[:2]] == [{}, {"samples": 10, "anisotropy": 1}]
    normal, fewer = made.preset("normal"), made.preset("draft")
    assert normal and fewer and fewer.bias > 1.4 * normal.bias and normal.evaluations == 28
    assert made.preset("reference").bias < 0.5 * normal.bias  # type: ignore[union-attr]
    kept = made.by_evaluations
    assert len(kept) > 3 and kept[-1].flip < 0.5 * kept[0].flip
    told = json.loads((tmp_path / "front.json").read_text())
    assert [e["flip"] for e in told["seconds"]] == [e.flip for e in made.front]
    assert told["engine"] == "made" and all(e["settings"].keys() <= set(NAMES) for e in told["evaluations"])
    with (tmp_path / "points.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(p.samples) for p in made.points)
    assert {int(row["pixel_samples"]) for row in rows} == {1, 2, 4, 8}
    height, width = made_passes.SHAPE
    assert all(read_png(picture_path(tmp_path, p)).shape[:2] == (2 * height, 4 * width) for p in made.points)
    assert made._repr_html_().startswith("<iframe")


def test_an_error_is_certain_where_a_tenth_of_the_reference_has_it() -> None:
    """Of as many passes, independent ones: ten times the squared error."""
    exact = made_passes.passes(0.0, 0.2)
    reference = render_reference(exact, True, 1e9, 0.01, lambda share: None)
    pixels, count = np.arange(np.prod(made_passes.SHAPE)), reference.passes // 10
    means = [
        np.mean([exact.render(count * k + i, pixels, lambda share: None) for i in range(count)], axis=0)
        for k in range(8)
    ]
    true = over_backdrop(made_passes.picture())
    errors = [flip(over_backdrop(mean.reshape(*made_passes.SHAPE, 4)), true) for mean in means]
    certain = run.Tradeoff("made", NAMES, reference, (), Path()).certain
    assert count >= 5 and np.mean(errors) == pytest.approx(certain, rel=0.25)


def test_values_in_one_place_have_one_label() -> None:
    """And a chain of near ones too; what is apart in time or in error has its own."""
    x, y = np.log([1.0, 1.1, 1.3, 4.0, 4.0]), np.log([0.1, 0.1, 0.1, 0.1, 0.2])
    labels = page._labels(["a", "b", "c", "d", "e"], x, y)
    assert [label for label, _ in labels] == ["a, b, c", "d", "e"]
    np.testing.assert_allclose([place for _, place in labels], [[x[:3].mean(), y[0]], [x[3], y[0]], [x[4], y[4]]])


def test_a_setting_alone_is_beside_what_does_nothing_without_a_filter() -> None:
    """Without a filter its width is no change of its own: that point is of `filtering`, and of nothing else."""
    names = ("filtering", "footprint")
    values = ({"filtering": True, "footprint": 0.5}, {"filtering": True, "footprint": 0.7})
    values += ({"filtering": False, "footprint": 0.25},)
    points = tuple(
        Point(v, (1.0, 1.0, 1.0), 0.0, 1.0, (1,), (0.1,), (0.0,), (0.0,), 0.0, 0.0, 0.0, 0.0) for v in values
    )
    dark = np.zeros((1, 1, 4))
    made = run.Tradeoff("made", names, Reference(dark, dark, 0.0, 0.0, 1, True), points, Path())
    assert [p.settings for p in page._alone(made, "filtering")] == [values[0], values[2]]
    assert [p.settings for p in page._alone(made, "footprint")] == [values[1], values[0]]


def test_csv_has_a_column_for_each_thing(first: tuple[run.Tradeoff, Path]) -> None:
    """The knob `samples` and the number of samples a pixel are not the same column."""
    header = (first[1] / "points.csv").read_text().splitlines()[0].split(",")
    assert len(set(header)) == len(header) and {"samples", "pixel_samples", "anisotropy", "flip"} <= set(header)


def test_a_later_run_goes_on(few, first, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, _ = first
    monkeypatch.setattr(run, "MAX_POINTS", 12)
    second = explored(folder)
    assert second.points[:9] == made.points and len(second.points) == 12
    assert second.reference.noise == made.reference.noise
    settings = [p.settings for p in second.points]
    assert all(s not in settings[:i] for i, s in enumerate(settings))


def test_another_scene_is_refused_and_nothing_is_lost(few, folder: Path) -> None:
    held = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    with pytest.raises(ms.InputError, match="holds the tradeoff of another scene"):
        explored(folder, shift=0.05)
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == held


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("points.json", '{"points": [{"settings": {}}]}', "holds no points"),
        ("points.json", "[", "not JSON"),
        ("points.json", '{"points": 3}', "holds no points"),
        ("reference.npz", "no archive", "is no reference"),
    ],
)
def test_a_broken_folder_is_named(few, folder: Path, name: str, text: str, said: str) -> None:
    (folder / name).write_text(text)
    with pytest.raises(ms.InputError, match=said) as caught:
        explored(folder)
    assert str(caught.value).startswith(str(folder / name))


@pytest.mark.parametrize("minutes", [0.0, -1.0, float("nan"), float("inf")])
def test_minutes_are_checked_first(tmp_path: Path, minutes: float) -> None:
    with pytest.raises(ms.InputError, match="minutes: must be above 0"):
        run.explore(lambda q: pytest.fail("prepared"), (), tmp_path / "new", minutes, lambda share, what: None)
    assert not (tmp_path / "new").exists()


def test_a_path_tracers_reference_is_of_other_paths(few, tmp_path: Path) -> None:
    made = explored(tmp_path, engine="mitsuba")
    assert not made.reference.same_rays and made.points[0].samples == (1, 2, 4, 8, 16, 32, 64)


CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_page_runs_in_a_browser(first: tuple[run.Tradeoff, Path]) -> None:
    """Its slider shows an entry of the front, with its picture and the options that render it."""
    made, folder = first
    assert CHROMIUM
    report = folder / "report.html"
    asked = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", report.as_uri()]
    shown = subprocess.run(asked, capture_output=True, text=True, timeout=120, check=True).stdout
    entry = made.front[len(made.front) // 2]
    assert f"{entry.seconds:.2f} s" in shown and entry.described in shown
    assert '<code id="how">--quality normal --set pixel_samples=' in shown
    picture = shown.split('id="picture"')[1].split(">")[0]
    assert 'src="data:image/png;base64,' in picture
    assert "NaN" not in shown and "undefined" not in shown
