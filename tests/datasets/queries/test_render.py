"""A dataset of queries: what its columns say is what is there, and a run that was interrupted ends up as one that was not."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from mesoshell.datasets.queries.render import (
    FINEST,
    GRAZING,
    MIN_COSINE,
    WIDEST,
    Settings,
    check_curvature,
    of_geometry,
    render_patches,
    sample,
)
from mesoshell.datasets.queries.sources import source
from mesoshell.datasets.queries.tile import PatchPlacement, Tile
from mesoshell.datasets.queries.trace import Patch, queries
from mesoshell.errors import InputError
from mesoshell.io.query_dataset import COLUMNS, read_patches


@pytest.fixture(scope="module")
def image(tmp_path_factory) -> Path:
    """Heights of few pixels, which look like nothing else when they are turned, mirrored or shifted."""
    v, u = ((np.arange(8) + 0.5) / 8 * 2 * np.pi for _ in range(2))
    heights = np.sin(u) + 0.7 * np.sin(2 * v[:, None] + u) + 0.4 * np.cos(u - v[:, None])
    path = tmp_path_factory.mktemp("heights") / "hills.png"
    Image.fromarray(np.round((heights - heights.min()) / np.ptp(heights) * 65535).astype(np.uint16)).save(path)
    return path


@pytest.fixture(scope="module")
def settings(image) -> Settings:
    return Settings(str(image), 0.12, (-1.0, 2.0), queries=64, spp=2, seed=3)


def answers(settings: Settings):
    return of_geometry(source(settings.source, settings.depth), settings.spp)


def made(settings: Settings, count: int, folder: Path) -> dict[str, float]:
    return render_patches(settings, answers(settings), count, folder, lambda done, of: None)


def files(folder: Path) -> dict[str, bytes]:
    """All but the log, which says how long it took."""
    found = (path for path in folder.rglob("*") if path.is_file() and path.name != "log.jsonl")
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def named(rows: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(**dict(zip(COLUMNS, rows.T.astype(float), strict=True)))


def fault_of(call, *args) -> str:
    with pytest.raises(InputError) as caught:
        call(*args)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture(scope="module")
def whole(settings, tmp_path_factory) -> Path:
    """Four patches, made at once."""
    folder = tmp_path_factory.mktemp("patches") / "whole"
    spent = made(settings, 4, folder)
    assert spent["new"] == 4 and spent["geometry"] > 0 and spent["light"] > 0
    return folder


def test_a_folder_is_what_its_reader_expects(whole, settings):
    found = read_patches(whole)
    assert [patch.shape for patch in found.patches] == [(64, 16)] * 4
    assert [set(patch[:, COLUMNS.index("patch")]) for patch in found.patches] == [{0}, {1}, {2}, {3}]
    rows = [json.loads(line) for line in (whole / "samples.jsonl").read_text().splitlines()]
    assert [row["index"] for row in rows] == [0, 1, 2, 3]
    for row, patch in zip(rows, found.patches, strict=True):
        assert np.float32(row["curvature"]) == patch[0, COLUMNS.index("kappa")]
    expected = {"queries": 64, "spp": 2, "seed": 3, "count": 4, "source": settings.source, "curvature": [-1.0, 2.0]}
    assert expected.items() <= found.manifest.items()


def test_twice_is_the_same_bytes(whole, settings, tmp_path):
    made(settings, 4, tmp_path / "again")
    assert files(tmp_path / "again") == files(whole)


def test_an_interrupted_run_goes_on(whole, settings, tmp_path):
    """Two first; then the third is cut off, as it lies there, and its row is missing; then all."""
    folder = tmp_path / "parts"
    made(settings, 2, folder)
    (folder / "patches/.000002.npy.0123456789abcdef.partial").write_bytes(b"half")
    with (folder / "samples.jsonl").open("a") as file:
        file.write('{"index": 2, "file": "patch')
    spent = made(settings, 4, folder)
    assert spent["new"] == 2 and files(folder) == files(whole)
    assert made(settings, 4, folder) == {"geometry": 0, "light": 0, "new": 0} and files(folder) == files(whole)


def test_what_was_lost_is_made_again(whole, settings, tmp_path):
    folder = tmp_path / "holes"
    made(settings, 4, folder)
    (folder / "patches/000001.npy").unlink()
    assert made(settings, 4, folder)["new"] == 1 and files(folder) == files(whole)


def test_a_run_that_ends_early_leaves_what_it_has(whole, settings, tmp_path):
    """As if it were interrupted from outside: what is there can be read, and the rest follows."""

    def ends(done: int, of: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    folder = tmp_path / "early"
    with pytest.raises(KeyboardInterrupt):
        render_patches(settings, answers(settings), 4, folder, ends)
    assert len(read_patches(folder).patches) == 2
    assert made(settings, 4, folder)["new"] == 2 and files(folder) == files(whole)


def test_progress_is_shown(settings, tmp_path):
    seen = []
    render_patches(
        replace(settings, queries=4), answers(settings), 2, tmp_path / "d", lambda done, of: seen.append((done, of))
    )
    assert seen == [(0, 2), (1, 2), (2, 2)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 4}, "has seed 3, asked for 4"),
        ({"queries": 65}, "has queries 64, asked for 65"),
        ({"spp": 3}, "has spp 2, asked for 3"),
        ({"depth": 0.2}, "has depth 0.12, asked for 0.2"),
        ({"curvature": (-1.0, 1.0)}, "has curvature [-1.0, 2.0], asked for [-1.0, 1.0]"),
    ],
)
def test_other_settings_are_refused(whole, settings, change, said):
    before = files(whole)
    assert fault_of(made, replace(settings, **change), 5, whole) == f"{whole / 'manifest.json'}: {said}"
    assert files(whole) == before


def test_another_image_of_the_same_name_is_refused(settings, image, tmp_path):
    (tmp_path / "a.png").write_bytes(image.read_bytes())
    settings = replace(settings, source=str(tmp_path / "a.png"), queries=4)
    made(settings, 1, tmp_path / "d")
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(tmp_path / "a.png")
    assert "has source_sha256" in fault_of(made, settings, 2, tmp_path / "d")


def test_a_dataset_of_images_is_no_place_for_patches(settings, tmp_path):
    (tmp_path / "manifest.json").write_text('{"schema": 1, "recipe": "grass", "count": 3}')
    assert "has recipe grass, asked for None" in fault_of(made, settings, 1, tmp_path)
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "patches").mkdir()
    (tmp_path / "patches/000000.npy").write_bytes(b"")
    assert "no manifest.json" in fault_of(made, settings, 1, tmp_path)


@pytest.mark.parametrize(
    ("curvature", "depth", "said"),
    [
        ((1.0, 1.0), 0.1, "1 to 1 is no range"),
        ((2.0, -1.0), 0.1, "2 to -1 is no range"),
        ((float("nan"), 1.0), 0.1, "nan to 1 is no range"),
        ((0.0, float("inf")), 0.1, "0 to inf is no range"),
        ((-1.0, 5.0), 0.2, "a layer 0.2 deep does not fit under a surface of radius 0.2: at most 4.75"),
    ],
)
def test_cylinders_that_cannot_be(curvature, depth, said):
    assert fault_of(check_curvature, curvature, depth) == f"curvature: {said}"
    check_curvature((-3.0, 4.7), 0.2)


def test_cylinders_that_cannot_be_leave_no_folder(settings, tmp_path):
    fault_of(made, replace(settings, curvature=(0.0, 9.0)), 1, tmp_path / "d")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def many(settings) -> list[np.ndarray]:
    """Patches of many queries, of a source that is made quickly."""
    asked = replace(settings, queries=4000, spp=1)
    tile = source(settings.source, settings.depth)
    return [sample(asked, of_geometry(tile, asked.spp), index)[0] for index in range(16)]


def test_queries_are_unit_vectors_and_answers_can_be(many):
    for index, rows in enumerate(many):
        q = named(rows)
        assert rows.dtype == np.float32 and rows.shape == (4000, 16) and np.isfinite(rows).all()
        np.testing.assert_allclose(q.wx**2 + q.wy**2 + q.wz**2, 1, atol=1e-6)
        np.testing.assert_allclose(q.lx**2 + q.ly**2 + q.lz**2, 1, atol=1e-6)
        assert (q.u.min() >= 0) and (q.u.max() <= 1) and (q.v.min() >= 0) and (q.v.max() <= 1)
        assert set(q.alpha) <= {0.0, 1.0} and q.cosine.min() >= 0 and q.cosine.max() <= 1
        assert min(q.r.min(), q.g.min(), q.b.min()) >= 0 and q.r.max() > 0
        assert not np.stack([q.r, q.g, q.b])[:, q.alpha == 0].any()
        assert set(q.patch) == {index} and len(set(q.kappa)) == 1


def test_views_are_across_the_axis(many):
    """In (u, v) all rays of a patch come from two opposite sides, and the sides differ from patch to patch."""
    axes = []
    for rows in many:
        q = named(rows)
        way = np.stack([q.wx, q.wy]) / np.hypot(q.wx, q.wy)
        clear = q.wz < 0.99
        sides = np.sign(way[0] * way[0, 0] + way[1] * way[1, 0])
        np.testing.assert_allclose((sides * way)[:, clear], np.broadcast_to(way[:, :1], way.shape)[:, clear], atol=1e-4)
        assert abs((sides > 0).mean() - 0.5) < 5 * 0.5 / np.sqrt(len(sides))
        axes.append(float(np.arctan2(way[1, 0], way[0, 0]) % np.pi))
    assert np.diff(np.sort(axes)).min() > 1e-4


def test_every_eighth_patch_is_flat_and_the_others_are_of_their_range(many):
    kappa = np.array([named(rows).kappa[0] for rows in many])
    np.testing.assert_array_equal(np.flatnonzero(kappa == 0), [7, 15])
    curved = kappa[kappa != 0]
    assert (
        len(set(curved)) == 14 and curved.min() > -1 and curved.max() < 2 and (curved > 0).any() and (curved < 0).any()
    )
    assert (named(many[7]).alpha == 1).all() and named(many[7]).cosine.max() < 0.01


def test_queries_are_spread_as_it_says(many):
    """Shares of 64 000 queries, within five standard deviations; and that they do not go together."""
    q = named(np.concatenate(many))
    n = len(q.u)

    def near(share, expected: float) -> None:
        assert abs(np.mean(share) - expected) < 5 * np.sqrt(expected * (1 - expected) / n), (np.mean(share), expected)

    grazing = 0.25 + 0.75 * (GRAZING - MIN_COSINE) / (1 - MIN_COSINE)
    near(q.wz < GRAZING, grazing)
    near(q.wz < (MIN_COSINE + GRAZING) / 2, grazing / 2)
    assert q.wz.min() >= MIN_COSINE - 1e-6
    near(q.lz < 0, 0.25)
    near((q.lz > 0) & (q.lz < 0.5), 0.375)
    near((q.lz < 0) & (q.lz > -0.5), 0.125)
    near((q.lx > 0) & (q.ly > 0), 0.25)
    near(q.radius < FINEST * 1.0001, 0.5)
    near(q.radius < np.sqrt(FINEST * WIDEST), 0.75)
    assert abs(q.radius.max() / WIDEST - 1) < 0.01
    near((q.wz < GRAZING) & (q.lz < 0) & (q.radius < FINEST * 1.0001), grazing / 8)
    for column in (q.u, q.v):
        assert np.histogram(column, 8, (0, 1))[0].min() > 0.5 * n / 8


def test_a_patch_depends_on_its_number_and_seed_alone(settings, whole):
    tile = source(settings.source, settings.depth)
    third, _ = sample(settings, of_geometry(tile, settings.spp), 2)
    np.testing.assert_array_equal(third, read_patches(whole).patches[2])
    other, _ = sample(replace(settings, seed=4), of_geometry(tile, settings.spp), 2)
    assert not np.isclose(other[:, :10], third[:, :10]).all(axis=1).any()


def dimmed(tile: Tile) -> Tile:
    """So dark that it is lit directly alone, which is exact."""
    r, g, b = (1e-4 * c for c in tile.body)
    return replace(tile, albedo=1e-4 * tile.albedo, body=(r, g, b))


@pytest.mark.parametrize("index", [0, 1, 2, 7])
def test_a_row_is_a_query_that_can_be_asked_again(settings, index, monkeypatch):
    """By its columns alone: a new patch whose middle is (u, v) and whose axis lies across ω, of curvature κ, asked there in its
    own frame. Whatever the rows were turned, shifted and moved by, answers agree."""
    monkeypatch.setattr("mesoshell.datasets.queries.render.FINEST", 1e-7)
    tile = dimmed(source(settings.source, settings.depth))
    rows, _ = sample(replace(settings, spp=1, widest=2e-7), of_geometry(tile, 1), index)
    q = named(rows)
    again, wrong = [], []
    for k in range(40):
        turn = float(np.arctan2(q.wy[k], q.wx[k]))
        placing = PatchPlacement(float(q.kappa[k]), turn, (float(q.u[k]), float(q.v[k])))
        patch = Patch(tile, placing, (2.5, 2.0))
        c, s = np.cos(turn), np.sin(turn)
        light = [c * q.lx[k] + s * q.ly[k], c * q.ly[k] - s * q.lx[k], q.lz[k]]
        mirrored = [light[0], -light[1], light[2]]
        view = np.array([[np.sqrt(1 - q.wz[k] ** 2), 0, q.wz[k]]] * 2)
        asked = {"place": np.zeros((2, 2)), "radius": np.zeros(2), "toward": view, "light": np.array([light, mirrored])}
        found = queries(patch, placing, asked, 1, 0)
        both = np.concatenate([found["alpha"], found["cosine"], 1e4 * found["reflectance"]], axis=1)
        again.append(both[0])
        wrong.append(both[1])
    expected = np.stack([q.alpha, q.cosine, 1e4 * q.r, 1e4 * q.g, 1e4 * q.b], axis=1)[:40]
    assert (np.abs(np.array(again) - expected).max(axis=1) < 2e-3).mean() > 0.9
    assert (np.abs(np.array(wrong) - expected).max(axis=1) < 2e-3).mean() < 0.75, "the comparison sees a difference"
