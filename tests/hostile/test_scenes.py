"""Scenes of Mitsuba's that cannot be rendered end in one line."""

from pathlib import Path

import pytest

from mesoshell.cli.main import main

FILM = '<film type="hdrfilm"><integer name="width" value="{0}"/><integer name="height" value="{0}"/></film>'
SCENES = {
    "no sensor": '<scene version="3.0.0"></scene>',
    "entity": '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/hostname">]><scene version="3.0.0">&e;</scene>',
    "torn": '<scene version="3.0.0"><sensor',
    "empty": "",
    "binary": "\0\1\2",
    "no scene": "<x/>",
    "unknown": '<scene version="3.0.0"><shape type="none"/></scene>',
    "large": '<scene version="3.0.0"><sensor type="perspective">' + FILM.format(200000) + "</sensor></scene>",
}


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_that_is_none_is_refused(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    (tmp_path / "a.xml").write_text(SCENES[name])
    with pytest.raises(SystemExit) as end:
        main(["render", str(tmp_path / "a.xml"), "--engine", "mitsuba", "--out", str(tmp_path / "o.png")])
    lines = [x for x in capfd.readouterr().err.splitlines() if x.startswith("mesoshell: ")]
    assert end.value.code == 2 and len(lines) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.xml"]
