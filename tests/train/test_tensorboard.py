"""What a run shows to TensorBoard is what its log says; without TensorBoard there is nothing, and no complaint."""

import importlib
import struct
from pathlib import Path

import numpy as np
import pytest

from mesoshell.io.image import write_png
from mesoshell.train import tensorboard

PACKAGES: dict[str, tuple[str, str]] = dict(zip(("tensorboard", "tensorboardX"), tensorboard._PACKAGES, strict=True))


def events(folder: Path, messages: str) -> list:
    """All events of a folder. A file is records of length (8 bytes), its check (4), the message and its check (4)."""
    event, found = importlib.import_module(f"{messages}.event_pb2").Event, []
    for path in sorted(folder.iterdir()):
        data, at = path.read_bytes(), 0
        while at < len(data):
            (size,) = struct.unpack_from("<Q", data, at)
            found.append(event.FromString(data[at + 12 : at + 12 + size]))
            at += 16 + size
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_what_was_written_is_read_back(package: str, tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip(package, reason=f"{package} is not installed")
    monkeypatch.setattr(tensorboard, "_PACKAGES", (PACKAGES[package],))
    path = tmp_path / "000000256.png"
    write_png(path, np.linspace(0, 1, 5 * 7 * 3).reshape(5, 7, 3))
    shown = tensorboard.open_board(tmp_path / "board")
    shown.row({"kimg": 0.128, "generator": 0.5, "real": -1.25})
    shown.row({"kimg": 0.256, "generator": 0.25, "real": float("nan")})
    shown.sheet(path)
    shown.close()
    found = [e for e in events(tmp_path / "board", PACKAGES[package][1]) if e.HasField("summary")]
    rows = [{v.tag: v.simple_value for v in e.summary.value} for e in found[:2]]
    assert [e.step for e in found] == [128, 256, 256]
    assert rows[0] == pytest.approx({"kimg": 0.128, "generator": 0.5, "real": -1.25})
    assert rows[1] == pytest.approx({"kimg": 0.256, "generator": 0.25})
    (sheet,) = found[2].summary.value
    assert (sheet.tag, sheet.image.width, sheet.image.height) == ("sheet", 7, 5)
    assert sheet.image.encoded_image_string == path.read_bytes()


def test_without_a_package_nothing_is_written(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(tensorboard, "_PACKAGES", (("no_such_package.writer", "no_such_package.proto"),))
    shown = tensorboard.open_board(tmp_path / "board")
    shown.row({"kimg": 1.0})
    shown.sheet(tmp_path / "missing.png")
    shown.close()
    assert not (tmp_path / "board").exists()
