"""From photographs to an edited object and a mesh with grass on it, by the commands a user calls; one line for each fault."""

import json
import shutil
from typing import Any

import numpy as np
import pytest
import trimesh

from mesoshell.cli.main import main
from mesoshell.io.image import read_exr, read_png, write_png
from mesoshell.neutex.layout import shape
from mesoshell.neutex.mesh import extract_mesh
from mesoshell.neutex.store import read_neutex
from mesoshell.train.run_config import snapshots
from tests.helpers import balls

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("atlas_cli")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("made")
    balls.write_capture(made / "capture", views=10, size=24)
    main(["atlas", "train", str(made / "capture"), "--run", str(made / "run"), "--preset", "tiny", "--kimg", "10.24"])
    return made


def fault(capsys, *words: object) -> str:
    with pytest.raises(SystemExit) as status:
        main([str(w) for w in words])
    assert status.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_a_run_is_scored(folder, capsys) -> None:
    main(["evaluate", str(folder / "run"), "--snapshots", "1"])
    said = capsys.readouterr().out
    assert "PSNR" in said and "texture used" in said
    rows = [json.loads(line) for line in (folder / "run/evaluation.jsonl").read_text().splitlines()]
    assert {row["name"] for row in rows} >= {"PSNR", "SSIM", "texture distortion"}


@pytest.mark.parametrize("layout", ["cubemap", "latlong", "square"])
def test_textures_of_each_layout(folder, tmp_path, layout) -> None:
    for name, read in (("a.png", read_png), ("a.exr", read_exr)):
        main(
            ["atlas", "texture", str(folder / "run"), "--layout", layout, "--size", "16", "--out", str(tmp_path / name)]
        )
        assert read(tmp_path / name).shape == (*shape(layout, 16), 3)


def test_an_edited_texture_is_seen_from_two_sides(folder, tmp_path) -> None:
    """A texture painted red shows red in every frame; the background does not."""
    write_png(tmp_path / "red.png", np.broadcast_to(np.array([1.0, 0, 0], np.float32), (16, 32, 3)))
    common = ["--frames", "2", "--size", "24", "24"]
    main(["atlas", "render", str(folder / "run"), *common, "--out", str(tmp_path / "plain")])
    main(
        [
            "atlas",
            "render",
            str(folder / "run"),
            *common,
            "--texture",
            str(tmp_path / "red.png"),
            "--out",
            str(tmp_path / "red"),
        ]
    )
    for i in range(2):
        plain, red = (read_exr(tmp_path / name / f"{i:04d}.exr") for name in ("plain", "red"))
        inside = plain[..., 3] > 0.5
        assert inside.sum() > 20
        assert (red[inside][:, 0] > 2 * red[inside][:, 1]).mean() > 0.95
        np.testing.assert_allclose(red[..., 3], plain[..., 3], atol=2e-3)
        assert read_png(tmp_path / "red" / f"{i:04d}.png").shape == (24, 24, 4)


def test_photographs_are_rendered_again(folder, tmp_path) -> None:
    """Over the frames of a longer path, of which none are left; what else is there stays."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "0010.png").write_text("mine")
    for path, count in (("photographs", 10), ("held-out", 1)):
        main(["atlas", "render", str(folder / "run"), "--path", path, "--checker", "--out", str(tmp_path / "out")])
        assert len(list((tmp_path / "out").glob("*.png"))) - 1 == len(list((tmp_path / "out").glob("*.exr"))) == count
    assert (tmp_path / "out" / "0010.png").read_text() == "mine"


def test_a_mesh_is_where_the_object_was_and_renders(folder, tmp_path) -> None:
    known = read_neutex(snapshots(folder / "run")[-1][1])
    for name in ("a.glb", "a.obj"):
        main(["atlas", "mesh", str(folder / "run"), "--quads", "10", "--size", "16", "--out", str(tmp_path / name)])
        mesh = trimesh.load_mesh(tmp_path / name)
        wanted = known.centre + known.half * extract_mesh(known.config, known.field, 10, 16).vertices
        np.testing.assert_allclose(mesh.bounds, [wanted.min(axis=0), wanted.max(axis=0)], atol=1e-5)
        mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=5)
        assert mesh.is_watertight
    words = ["--material", "grass", "--thickness", "0.1", "--size", "24", "24", "--quality", "draft", "--out"]
    main(["render", str(tmp_path / "a.glb"), *words, str(tmp_path / "grass.png")])
    assert (read_exr(tmp_path / "grass.exr")[..., 3] > 0.5).mean() > 0.1


def test_faults_are_one_line(folder, tmp_path, capsys) -> None:
    run = folder / "run"
    (tmp_path / "empty").mkdir()
    assert "empty: no capture" in fault(capsys, "atlas", "train", tmp_path / "empty", "--run", tmp_path / "r")
    assert not (tmp_path / "r").exists()
    assert "a.jpg: must end in .png or .exr" in fault(capsys, "atlas", "texture", run, "--out", tmp_path / "a.jpg")
    words = ("--part", "roughness", "--out", tmp_path / "a.exr")
    assert "has colours as photographed, but no roughness" in fault(capsys, "atlas", "texture", run, *words)
    assert "a.ply: must end in .glb or .obj" in fault(capsys, "atlas", "mesh", run, "--out", tmp_path / "a.ply")
    assert "--quads: must be at least 1" in fault(
        capsys, "atlas", "mesh", run, "--quads", 0, "--out", tmp_path / "a.glb"
    )
    for words, other in (
        (("--edit", "multiply"), "texture"),
        (("--layout", "latlong"), "texture"),
        (("--irradiance", 2), "light"),
        (("--up", "z"), "environment"),
    ):
        said = fault(capsys, "atlas", "render", run, *words, "--out", tmp_path / "f")
        assert f"{words[0]}: requires --{other}" in said
    both = "--checker", "--texture", tmp_path / "a.png"
    assert "--checker: cannot be combined with --texture" in fault(
        capsys, "atlas", "render", run, *both, "--out", tmp_path / "f"
    )
    missing = "--texture", tmp_path / "none.png"
    assert "none.png: no such file" in fault(capsys, "atlas", "render", run, *missing, "--out", tmp_path / "f")
    write_png(tmp_path / "odd.png", np.zeros((7, 9, 3), np.float32))
    odd = "--texture", tmp_path / "odd.png"
    assert "odd.png: is 9 x 7 pixels" in fault(capsys, "atlas", "render", run, *odd, "--out", tmp_path / "f")
    assert not (tmp_path / "f").exists()
    again = "atlas", "train", folder / "capture", "--run", tmp_path / "r"
    for kimg in (-1, "inf"):
        assert "--kimg: must be above 0" in fault(capsys, *again, "--kimg", kimg)
    twice = "--encoding", "hash", "--experiment", "experiments/atlas_nerf.py"
    assert "--encoding: cannot be combined with --experiment" in fault(capsys, *again, *twice)
    shot = "atlas", "capture", "src/mesoshell/assets/spot.obj", "--out", tmp_path / "r"
    assert "--seed: must be at least 0, not -1" in fault(capsys, *shot, "--seed", -1)


@pytest.mark.slow
def test_what_has_no_texture_says_so(folder, tmp_path, capsys) -> None:
    """A NeRF renders; it has nothing to paint on."""
    experiment = "experiments/atlas_nerf.py"
    words = ["--preset", "tiny", "--kimg", "1.024", "--experiment", experiment]
    main(["atlas", "train", str(folder / "capture"), "--run", str(tmp_path / "nerf"), *words])
    main(["atlas", "render", str(tmp_path / "nerf"), "--frames", "1", "--size", "8", "8", "--out", str(tmp_path / "f")])
    capsys.readouterr()
    said = fault(capsys, "atlas", "texture", tmp_path / "nerf", "--out", tmp_path / "a.png")
    assert "has its colours in the volume, but no texture" in said


@pytest.mark.slow
def test_reflectance_is_lit_anew_and_its_parts_are_written(folder, tmp_path, capsys) -> None:
    """Roughness and specular are numbers in an EXR, within what lobes allow; a GLB has the roughness; a light that is not the
    camera's changes the picture and not what it covers."""
    capture = shutil.copytree(folder / "capture", tmp_path / "capture")
    about = json.loads((capture / "transforms.json").read_text())
    (capture / "transforms.json").write_text(json.dumps({**about, "flash": 30.0}))
    run, experiment = tmp_path / "run", ["--experiment", "experiments/atlas_reflectance.py"]
    main(["atlas", "train", str(capture), "--run", str(run), "--preset", "tiny", "--kimg", "5.12", *experiment])
    capsys.readouterr()
    for part, most in (("roughness", 1.0), ("specular", 0.25)):
        words = ["--part", part, "--size", "8", "--out"]
        main(["atlas", "texture", str(run), *words, str(tmp_path / "a.exr")])
        image = read_exr(tmp_path / "a.exr")
        assert (image > 0).all() and (image < most).all() and np.ptp(image) > 0
        assert "a.png: must end in .exr" in fault(capsys, "atlas", "texture", run, *words, tmp_path / "a.png")
    main(["atlas", "mesh", str(run), "--quads", "4", "--size", "8", "--out", str(tmp_path / "a.glb")])
    made: Any = trimesh.load_mesh(tmp_path / "a.glb")
    assert made.visual.material.metallicRoughnessTexture is not None
    frames = []
    for light in ([], ["--light", "0", "0", "1", "--quality", "draft"]):
        words = ["--frames", "1", "--size", "12", "12", "--out", str(tmp_path / "f")]
        main(["atlas", "render", str(run), *words, *light])
        frames.append(read_exr(tmp_path / "f/0000.exr"))
    np.testing.assert_allclose(frames[1][..., 3].mean(), frames[0][..., 3].mean(), atol=0.05)
    assert not np.allclose(frames[1][..., :3], frames[0][..., :3], rtol=0.05)
