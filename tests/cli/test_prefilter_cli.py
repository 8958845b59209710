"""`mesoshell prefilter`: a line a level and a corrected material, which another render sees; one line for each fault."""

from pathlib import Path

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.surface import write_surface
from mesoshell.train import prefilter
from tests.helpers import wearing

pytestmark = pytest.mark.xdist_group("prefilter")


@pytest.fixture
def few(monkeypatch, tmp_path_factory) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
    sizes = {"VIEWS": 64, "HELD": 8, "MANY": 16, "MORE": 16, "SAMPLES": 16, "FEW": 16, "BATCH": 16}
    for name, value in sizes.items():
        monkeypatch.setattr(prefilter, name, value)


@pytest.mark.slow  # two corrections; each is tested by itself
def test_a_material_is_corrected_by_the_command_and_in_python_alike(few, tiny_bundle, tmp_path, capsys) -> None:
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    out = tmp_path / "new" / "made.npz"
    main(["prefilter", str(tmp_path / "tiny.npz"), "--out", str(out), "--steps", "2", "--seed", "5"])
    said = capsys.readouterr()
    assert said.out == f"{out}\n"
    lines = said.err.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["level 1", "level 2"]
    assert "of the light, now" in lines[0] and "views differ by" in lines[0]
    seen: list[prefilter.Gap] = []
    made = ms.prefilter(ms.load_material(tmp_path / "tiny.npz"), steps=2, seed=5, show=seen.append)
    assert [gap.level for gap in seen] == [1, 2]
    found = read_bundle(out)
    for key, array in made.shell.arrays.items():
        np.testing.assert_array_equal(found.arrays[key], array, err_msg=key)
    assert found.provenance["correction"] == {
        "steps": 2,
        "seed": 5,
        "rms": [[*map(float, gap)] for gap in rounded(seen)],
    }


def test_what_is_corrected_is_in_no_file_until_it_is_saved(few, tiny_bundle, tmp_path) -> None:
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    made = ms.prefilter(ms.load_material(tmp_path / "tiny.npz"), steps=1)
    scene = ms.Scene(Path(__file__).parents[1] / "data" / "suzanne.obj", made, size=(16, 12))
    with pytest.raises(ms.InputError, match="is a material in no file"):
        ms.write_scene(scene, tmp_path / "scene")
    made.save(tmp_path / "made.npz")
    again = ms.load_material(tmp_path / "made.npz")
    assert again.shell.arrays.keys() == made.shell.arrays.keys() > tiny_bundle.arrays.keys()


def rounded(gaps: list[prefilter.Gap]) -> list[np.ndarray]:
    return [np.round(gap.rms, 4) for gap in gaps]


def test_faults_are_one_line(tiny_bundle, tmp_path: Path, capsys) -> None:
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    write_surface(tmp_path / "dots.npz", wearing.bundle())
    for arguments, expected in (
        (("tiny.npz", "--out", "a.png"), "a.png: must end in .npz"),
        (("tiny.npz", "--out", "a.npz", "--steps", "0"), "--steps: must be at least 1"),
        (("tiny.npz", "--out", "a.npz", "--seed", "4294967296"), "--seed: 4294967296 must be from"),
        (("dots.npz", "--out", "a.npz"), "dots.npz: manifest.json: kind is 'silhouette'; expected 'shell'"),
        (("missing.npz", "--out", "a.npz"), "missing.npz: no such material"),
    ):
        with pytest.raises(SystemExit) as caught, pytest.MonkeyPatch.context() as patch:
            patch.chdir(tmp_path)
            main(["prefilter", *arguments])
        said = capsys.readouterr().err
        assert caught.value.code == 2 and said.count("\n") == 1, said
        assert expected in said
        assert not (tmp_path / "a.npz").exists()
