"""From an experiment to a render, by the five commands a user calls; and one line for each fault."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.dataset import read_dataset
from mesoshell.io.image import read_exr, read_png, write_exr, write_png
from mesoshell.io.pack import pack_dataset
from mesoshell.measure import evaluation as measured
from mesoshell.measure.features import Extractor
from mesoshell.scene.materials import read_params
from tests.helpers import fog, growing

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("generator_cli")

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
#: A generator, as `mesoshell train` is told of one.
EXPERIMENT = """
from dataclasses import replace
from mesoshell.train.gan.presets import TINY
config = replace(
    TINY, discriminator=replace(TINY.discriminator, size=8), picture=replace(TINY.picture, size=8)
)
"""


#: The network that is compared with, at a size of its own.
NETWORK = """
from dataclasses import replace
from mesoshell.train.nerf_tex.network import nerf_tex_config
from mesoshell.train.gan.presets import TINY
config = replace(
    nerf_tex_config(TINY, seeded=True),
    picture=replace(TINY.picture, size=8),
    trunk=(8,),
    head=(8,),
    snapshot_kimg=0.008,
    kimg=0.016,
)
recipe = "fog"
"""


@pytest.fixture(autouse=True)
def _no_cache_at_home(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A generator's run of two snapshots, which nothing was spent on (test_run has one that learns), and its data."""
    folder = tmp_path_factory.mktemp("made")
    fog.write(folder / "fog", [(0.6, 0.3, 1.6 + 0.2 * k) for k in range(16)], size=8)
    pack_dataset(read_dataset(folder / "fog"), folder / "packed")
    growing.write_run(read_dataset(folder / "packed"), folder / "run", 8, 16)
    return folder / "run"


@pytest.fixture(scope="module")
def material(run, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("material") / "new" / "fog.npz"
    main(["export", str(run), "--out", str(out)])
    return out


def fault(capsys, *arguments: object) -> str:
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    return said


@pytest.fixture(scope="module")
def network(run) -> Path:
    """A run of the network on the same data."""
    folder = run.parent
    (folder / "network.py").write_text(NETWORK)
    given = ["train", str(folder / "network.py"), "--data", str(folder / "packed"), "--run", str(folder / "network")]
    main([*given, "--dry-run"])
    assert not (folder / "network").exists()
    main(given)
    return folder / "network"


def test_scores_are_kept_and_not_made_twice(run, tmp_path, capsys, monkeypatch) -> None:
    """With features that need no network; EfficientNet's are those of the network below."""
    colour = Extractor("Colour", lambda image: image[..., :3].mean(axis=(1, 2)))
    monkeypatch.setattr(measured, "extractor", lambda weights: colour)
    main(["evaluate", str(run), "--images", "8", "--snapshots", "2"])
    said = capsys.readouterr().out
    rows = [json.loads(line) for line in (run / "evaluation.jsonl").read_text().splitlines()]
    assert [(r["name"], r["kimg"], r["images"]) for r in rows] == [
        (name, kimg, 8) for name in ("FID-Colour", "KID-Colour") for kimg in (0.008, 0.016)
    ]
    assert all(r["low"] <= r["value"] <= r["high"] for r in rows)
    assert f"{rows[-1]['value']:.4g}" in said and "KID-Colour" in (run / "report.html").read_text()
    main(["evaluate", str(run), "--images", "8", "--snapshots", "2"])
    assert capsys.readouterr().out == f"{run / 'report.html'}\n"
    own = (run / "evaluation.jsonl").read_bytes()
    data = json.loads((run / "config.json").read_text())["data"]["folder"]
    main(["evaluate", str(run), "--images", "8", "--snapshots", "1", "--data", data])
    assert capsys.readouterr().out == f"{run / 'report.html'}\n"
    moved = shutil.copytree(data, tmp_path / "moved")
    main(["evaluate", str(run), "--images", "8", "--snapshots", "1", "--data", str(moved)])
    (other,) = run.glob("evaluation_moved_*.jsonl")
    assert capsys.readouterr().out.endswith(f"{other}\n") and len(other.read_text().splitlines()) == 2
    assert (run / "evaluation.jsonl").read_bytes() == own
    for kind in ("residual", "projected", "vision-aided"):
        record = shutil.copytree(run, tmp_path / kind) / "config.json"
        record.write_text(record.read_text().replace('"kind": "residual"', f'"kind": "{kind}"'))
        main(["evaluate", str(record.parent), "--images", "8", "--snapshots", "1"])
        assert ("judged by EfficientNet-Lite0" in capsys.readouterr().err) == (kind != "residual")


@pytest.mark.slow
def test_a_network_that_is_compared_with_is_scored_like_any_run(network, capsys) -> None:
    assert [p.name for p in sorted((network / "snapshots").iterdir())] == ["000000008.npz", "000000016.npz"]
    sheet = read_png(network / "sheets" / "000000016.png")
    assert sheet.shape[0] > 4 * 8 and sheet[..., :3].std() > 0.01
    capsys.readouterr()
    main(["evaluate", str(network), "--images", "8", "--snapshots", "1"])
    assert capsys.readouterr().out.startswith("0.016 kimg: KID-EffLite0 ")
    page = (network / "report.html").read_text()
    assert page.count("<img") == 5 and "0.016 kimg" in page
    row = json.loads((network / "log.jsonl").read_text().splitlines()[-1])
    assert row.keys() == {"kimg", "images_per_s", "radiance", "transmittance"}


def test_a_network_that_is_compared_with_is_no_material(network, run, tmp_path, capsys) -> None:
    """Each fault is one line; nothing is written."""
    snapshot = network / "snapshots" / "000000016.npz"
    assert "network but no generator: it can be evaluated" in fault(
        capsys, "export", network, "--out", tmp_path / "a.npz"
    )
    for verb in (["render", MESH, "--material", snapshot], ["texture", snapshot]):
        assert "kind is 'nerf_tex'; expected 'shell'" in fault(capsys, *verb, "--out", tmp_path / "a.png")
    given = ["--data", network.parent / "packed", "--run"]
    said = fault(capsys, "train", network.parent / "network.py", *given, run)
    assert "config.json: the run was begun by another method: gan, asked for nerf_tex" in said
    (run.parent / "experiment.py").write_text(EXPERIMENT)
    said = fault(capsys, "train", run.parent / "experiment.py", *given, tmp_path / "new", "--transfer", network)
    assert f"{network}: weights can be transferred only between generators' runs" in said
    (tmp_path / "e.py").write_text(NETWORK.replace('"fog"', '"carpet2"'))
    assert "packed: its recipe is fog; e.py is about carpet2" in fault(capsys, "train", tmp_path / "e.py", *given, "x")
    assert [p.name for p in tmp_path.iterdir()] == ["e.py"]


def test_an_export_is_the_newest_snapshot_or_the_one_asked_for(run, material, tmp_path, capsys) -> None:
    newest = read_bundle(material)
    assert newest.provenance["images"] == 16 and newest.generator is not None and not newest.baked
    main(["export", str(run), "--out", str(tmp_path / "a.npz"), "--kimg", "0.008"])
    assert read_bundle(tmp_path / "a.npz").provenance["images"] == 8
    assert "there are snapshots at 0.008, 0.016" in fault(capsys, "export", run, "--out", "b.npz", "--kimg", "3")
    assert "config.json: no such file" in fault(capsys, "export", tmp_path, "--out", "b.npz")


def test_a_texture_is_a_material_of_its_own(material, tmp_path, capsys) -> None:
    given = ["texture", str(material), "--extent", "3", "1.5", "--seed", "3", "--param", "age=4", "--out"]
    main([*given, str(tmp_path / "f.npz")])
    said = capsys.readouterr()
    assert said.out == f"{tmp_path / 'f.npz'}\n" and "48 × 24 texels" in said.err
    field = read_bundle(tmp_path / "f.npz")
    assert field.arrays["features/0"].shape == (24, 48, 4) and field.parameters[0].default == 4
    main([*given, str(tmp_path / "f")])
    mapped = read_bundle(tmp_path / "f")
    assert isinstance(mapped.arrays["features/0"], np.memmap)
    for key, array in field.arrays.items():
        np.testing.assert_array_equal(mapped.arrays[key], array)
    assert "exists already" in fault(capsys, "texture", material, "--out", tmp_path / "f")
    for extent in (("0", "1"), ("1e308", "1e308"), ("1", "1e200")):
        assert "at least a texel" in fault(
            capsys, "texture", material, "--extent", *extent, "--out", tmp_path / "g.npz"
        )
    for wrong in (5, 0, 32):
        said = fault(capsys, "texture", material, "--texels", wrong, "--out", tmp_path / "g.npz")
        assert f"--texels: {wrong}: the generator makes 16; fewer are 8, 4, ... 1" in said
    assert "no parameter 'x'" in fault(capsys, "texture", material, "--param", "x=1", "--out", tmp_path / "g.npz")
    assert "holds one texture and no generator" in fault(
        capsys, "texture", tmp_path / "f.npz", "--out", tmp_path / "g.npz"
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f", "f.npz"]
    main([*given, str(tmp_path / "coarse.npz"), "--texels", "4"])
    assert "12 × 6 texels" in capsys.readouterr().err
    coarse = read_bundle(tmp_path / "coarse.npz")
    assert coarse.texel_density == 4
    np.testing.assert_array_equal(coarse.arrays["features/0"], field.arrays["features/2"])


@pytest.mark.parametrize("engine", ["jax", pytest.param("mitsuba", marks=pytest.mark.slow)])
def test_a_texture_of_a_folder_is_that_of_a_file_and_begins_where_the_mesh_does(material, tmp_path, engine) -> None:
    """Baked for a square of 2 × 2 patches, it does not run out before the square's end: more of it changes nothing. Baked with
    the patch around it that lookups from afar reach, it is what grows there."""
    square = "v 0 0 0\nv 1 0 0\nv 1 0 -1\nv 0 0 -1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n"
    (tmp_path / "square.obj").write_text(square)
    for name, extent in (("file.npz", "2"), ("folder", "2"), ("more.npz", "3"), ("whole.npz", "4")):
        main(["texture", str(material), "--extent", extent, extent, "--seed", "0", "--out", str(tmp_path / name)])

    def seen(texture) -> np.ndarray:
        view = [
            "--camera",
            "0.5",
            "2",
            "-0.499",
            "0.5",
            "0",
            "-0.5",
            "20",
            "--scale",
            "0.5",
            "--set",
            "filtering=false",
        ]
        given = ["render", str(tmp_path / "square.obj"), "--material", str(texture), *view, "--size", "24", "24"]
        main([*given, "--engine", engine, "--out", str(tmp_path / "a.exr")])
        return read_exr(tmp_path / "a.exr")[3:-3, 3:-3]

    file, folder, more, whole = (seen(tmp_path / name) for name in ("file.npz", "folder", "more.npz", "whole.npz"))
    np.testing.assert_array_equal(file, folder)
    np.testing.assert_allclose(whole, seen(material), atol=1e-3)
    another = np.abs(whole - file).mean()  # a patch farther
    assert np.abs(more - file).mean() < 0.02 * another > 1e-4


def test_seeds_grow_on_a_mesh(material, tmp_path) -> None:
    def image(name: str, *more: object) -> np.ndarray:
        out = tmp_path / f"{name}.png"
        given = ["render", MESH, "--material", material, "--scale", 3, "--size", 16, 16, "--quality", "draft"]
        main([str(x) for x in (*given, "--out", out, *more)])
        return read_png(out)

    a, b, c = image("a"), image("b", "--seed", 0), image("c", "--seed", 1, "--param", "age=5")
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0.01 and np.isfinite(a).all()


@pytest.fixture(scope="module")
def combed(tmp_path_factory) -> tuple[Path, Path]:
    """A generator with a geometry parameter, and an image that is black on the left and white on the right."""
    folder = tmp_path_factory.mktemp("combed")
    write_bundle(folder / "it.npz", growing.bundle())
    write_png(
        folder / "map.png", np.repeat(np.array([[[0.0]], [[1.0]]]), 3, axis=2).transpose(1, 0, 2).astype(np.float32)
    )
    return folder / "it.npz", folder / "map.png"


@pytest.mark.slow
def test_images_vary_geometry_and_appearance(combed, tmp_path) -> None:
    """Each is a picture of its own (that a constant image is the constant, tests of nodes say)."""
    material, image = combed

    def picture(name: str, *more: object) -> np.ndarray:
        out = tmp_path / f"{name}.png"
        given = ["render", MESH, "--material", material, "--scale", 0.4, "--size", 32, 32, "--quality", "draft"]
        main([str(x) for x in (*given, "--out", out, *more)])
        return read_png(out)

    some = [("a",), ("b", "--param", f"length={image}"), ("c", "--param", f"age={image}")]
    pictures = [picture(*x) for x in some]
    for i, x in enumerate(pictures):
        for y in pictures[:i]:
            assert np.abs(x - y).max() > 0.01


def test_an_image_that_cannot_be_laid_into_a_texture_is_one_line(combed, tmp_path, capsys) -> None:
    material, image = combed
    given = ["texture", material, "--extent", 10, 2, "--param"]
    assert "age: an image varies appearance in a render only" in fault(
        capsys, *given, f"age={image}", "--out", tmp_path / "g.npz"
    )
    assert "length=nothing.png is neither a number nor an image" in fault(
        capsys, *given, "length=nothing.png", "--out", tmp_path / "g.npz"
    )


@pytest.mark.slow  # the path tracer's test of heights has one of an image made by the command
def test_a_texture_takes_images_of_geometry_alone(combed, tmp_path, capsys) -> None:
    # into a folder, from which it is rendered like a file
    material, image = combed
    given = ["texture", material, "--extent", 10, 2, "--param"]
    main([*map(str, given), f"length={image}", "--out", str(tmp_path / "f")])
    field = read_bundle(tmp_path / "f")
    heights = field.arrays["heights/0"].astype(np.float32)
    assert field.provenance["varies"] == ["length"] and heights.shape[:2] == (3, 11)
    np.testing.assert_array_equal(heights[:, :5], np.broadcast_to(heights[:1, :1], heights[:, :5].shape))
    np.testing.assert_array_equal(heights[:, 5:], np.broadcast_to(heights[:1, -1:], heights[:, 5:].shape))
    assert np.abs(heights[0, 0] - heights[0, -1]).max() > 0.01
    shown = ["--size", 16, 16, "--quality", "draft", "--out", tmp_path / "r"]
    main([str(x) for x in ("render", MESH, "--material", tmp_path / "f", *shown)])
    assert "length is baked into" in fault(
        capsys, "render", MESH, "--material", tmp_path / "f", "--param", f"length={image}"
    )


def test_images_of_parameters_are_pictures_or_numbers(combed, tmp_path) -> None:
    """OpenEXR holds numbers as they are; what lies outside 0 to 1 is refused."""
    bundle, image = read_bundle(combed[0]), np.array([[0.1, 0.7]], np.float32)
    write_exr(tmp_path / "a.exr", np.repeat(image[..., None], 3, axis=-1), half=False)
    np.testing.assert_allclose(read_params(bundle, {"length": tmp_path / "a.exr"})[1]["length"], image, rtol=1e-6)
    for wrong in (1.5, -0.1, np.nan):
        write_exr(tmp_path / "b.exr", np.full((1, 2, 3), wrong, np.float32))
        with pytest.raises(InputError, match="holds values outside 0 to 1"):
            read_params(bundle, {"length": tmp_path / "b.exr"})


def test_seeds_need_a_generator(tmp_path, capsys) -> None:
    assert "grass is one texture and has no generator" in fault(capsys, "render", MESH, "--seed", "3")


def test_a_run_without_snapshots_says_so(run, tmp_path, capsys) -> None:
    shutil.copytree(run, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "snapshots")
    assert "has no snapshots yet" in fault(capsys, "evaluate", tmp_path / "run")
    (tmp_path / "run" / "config.json").write_text("{}")
    assert "is no record of a training run" in fault(capsys, "evaluate", tmp_path / "run")
