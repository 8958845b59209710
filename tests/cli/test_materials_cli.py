"""What there is to grow is listed, with what can be set of it; without JAX."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from mesoshell.cli.main import main
from mesoshell.io import material
from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.material import bundled_materials
from mesoshell.io.surface import write_surface
from tests.helpers import wearing


def test_bundled_materials_are_listed(capsys) -> None:
    main(["materials"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines if not line.startswith(" ")] == list(bundled_materials())
    assert any(line.startswith("  --param age=0  from 0 to 1 (appearance): 0 is fresh green") for line in lines)


def test_what_is_baked_is_no_option(capsys) -> None:
    main(["materials", "pelt"])
    lines = capsys.readouterr().out.splitlines()
    assert "  length=0.65  fixed: length of the guard hairs" in lines
    assert [line.split("=")[0] for line in lines if "--param" in line] == [
        f"  --param {name}" for name in ("hue", "saturation", "value")
    ]


def test_larger_ones_are_in_a_package_of_their_own(capsys, monkeypatch) -> None:
    """24 MB are bundled at most; without the package, each of its names says where it is."""
    ours = [p for p in bundled_materials().values() if material.LARGER not in p.parts]
    assert sum(p.stat().st_size for p in ours) < 24e6
    assert {*material.WITH} == {*bundled_materials()} - {p.stem for p in ours}
    monkeypatch.setattr(material, "LARGER", "no_such_package")
    assert [*bundled_materials()] == sorted(p.stem for p in ours)
    where = (
        "is in a package of its own, mesoshell-materials: pip install ./packages/materials of mesoshell's repository"
    )
    for name in material.WITH:
        with pytest.raises(SystemExit, match="2"):
            main(["materials", name])
        assert capsys.readouterr().err.splitlines() == [f"mesoshell: {name}: {where}"]
    main(["materials"])
    assert capsys.readouterr().out.splitlines()[-1].startswith("pelt, turf: in a package of their own")


def test_given_ones_are_described(tmp_path: Path, monkeypatch, capsys) -> None:
    grass = read_bundle(material.find("grass"))
    monkeypatch.chdir(tmp_path)
    write_bundle("whole.npz", grass)
    write_bundle("cut.npz", replace(grass, wraps=False))
    write_bundle("tiles.npz", read_bundle(material.find("turf")))
    write_surface("woven.npz", wearing.bundle())
    main(["materials", "whole.npz", "cut.npz", "tiles.npz", "woven.npz"])
    (age,) = grass.parameters
    parameter = f"  --param age=0  from 0 to 1 (appearance): {age.meaning}"
    assert capsys.readouterr().out.splitlines() == [
        "whole.npz: shell, 256 texels a patch: one patch that repeats",
        parameter,
        "cut.npz: shell, 256 texels a patch: one texture with edges",
        parameter,
        "tiles.npz: shell, 128 texels a patch: endless, of 16 tiles; another order of them for each --seed",
        parameter,
        "woven.npz: surface material, one query a hit; no parameters",
    ]


def test_what_is_none_is_one_line(capsys) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["materials", "moss"])
    assert stop.value.code == 2
    assert capsys.readouterr().err.startswith("mesoshell: moss: no such material")


def test_it_loads_no_jax() -> None:
    check = "import sys\nfrom mesoshell.cli.main import main\nmain(['materials'])\nassert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", check], check=True, capture_output=True)
