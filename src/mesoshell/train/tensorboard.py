"""TensorBoard's event files, if a package that writes them is installed; nothing otherwise.

Notation
row        numbers of a log row by name, with `kimg` among them
sheet      a PNG file whose name is the number of images seen
step       TensorBoard's axis: images seen by the discriminator

`tensorboard` contains a writer; `tensorboardX` is a small one without the viewer. Neither needs TensorFlow or torch. A resumed
run opens another file in the same folder, and TensorBoard shows them as one.
"""

import importlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

#: Packages with their modules: the writer's, and the messages'.
_PACKAGES = (
    ("tensorboard.summary.writer.event_file_writer", "tensorboard.compat.proto"),
    ("tensorboardX.event_file_writer", "tensorboardX.proto"),
)


class Board(NamedTuple):
    """row: write numbers by name; sheet: write a picture; close: finish."""

    row: Callable[[dict[str, float]], None]
    sheet: Callable[[Path], None]
    close: Callable[[], None]


class _Modules(NamedTuple):
    writer: Any
    event: Any
    summary: Any


def open_board(folder: Path) -> Board:
    """Event files in `folder`, which is created; a board that writes nothing if no package is installed."""
    modules = _installed()
    return _writing(modules, folder) if modules else Board(lambda row: None, lambda path: None, lambda: None)


def _installed() -> _Modules | None:
    for writer, messages in _PACKAGES:
        try:
            names = (writer, f"{messages}.event_pb2", f"{messages}.summary_pb2")
            return _Modules(*map(importlib.import_module, names))
        except ImportError:
            continue
    return None


def _writing(modules: _Modules, folder: Path) -> Board:
    folder.mkdir(parents=True, exist_ok=True)
    writer, value = modules.writer.EventFileWriter(str(folder)), modules.summary.Summary.Value

    def write(step: int, values: list[Any]) -> None:
        summary = modules.summary.Summary(value=values)
        writer.add_event(modules.event.Event(wall_time=time.time(), step=step, summary=summary))
        writer.flush()

    def row(numbers: dict[str, float]) -> None:
        step = round(1000 * numbers["kimg"])
        write(step, [value(tag=name, simple_value=float(x)) for name, x in numbers.items() if np.isfinite(x)])

    def sheet(path: Path) -> None:
        with Image.open(path) as image:
            width, height = image.size
        encoded = path.read_bytes()
        picture = modules.summary.Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=encoded)
        write(int(path.stem), [value(tag="sheet", image=picture)])

    return Board(row, sheet, writer.close)
