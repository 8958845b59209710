"""A training run on a viewer's page: its snapshots, each with its sheet, and its curves, as it trains."""

import io
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mesoshell.errors import InputError
from mesoshell.train.report import curves
from mesoshell.train.run_config import snapshots

#: Seconds between looks at the folder.
EVERY = 3.0
NEWEST = "newest"


class RunPanel:
    """A folder of a server's page about a run. worn: its snapshot that is shown; set_material: called with the file of another
    one, says whether that is shown now; say: with what is wrong with the run's folder, empty if nothing is. Looks at the folder
    until it is closed."""

    def __init__(
        self, gui: Any, folder: Path, worn: Path, set_material: Callable[[Path], bool], say: Callable[[str], None]
    ):
        self._folder, self._set_material, self._say = folder, set_material, say
        self._worn = worn
        self._seen: tuple[Any, ...] = ()
        self._refused: tuple[Any, ...] = ()
        self._turn, self._closed = threading.RLock(), threading.Event()  # viser calls back where options are set
        with gui.add_folder(f"Run: {folder.name}", order=-1):
            hint = "by thousands of images, or rays, seen; the newest is followed"
            self._which = gui.add_dropdown("snapshot", (NEWEST,), initial_value=NEWEST, hint=hint)
            blank = np.full((1, 1, 3), 255, np.uint8)
            self._sheet, self._curves = (gui.add_image(blank, visible=False) for _ in range(2))
        self._which.on_update(lambda _: self.refresh())
        self.refresh()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closed.set()
        self._thread.join()

    def refresh(self) -> None:
        """Show what the folder holds now."""
        try:
            self._refresh()
        except Exception as fault:  # the next look may find it whole
            self._say(
                str(fault) if isinstance(fault, InputError) else f"{self._folder}: {type(fault).__name__}: {fault}"
            )
        else:
            self._say("")

    def _refresh(self) -> None:
        with self._turn:
            files = {f"{images / 1000:.12g} kimg": path for images, path in reversed(snapshots(self._folder))}
            if (options := (NEWEST, *files)) != tuple(self._which.options):
                self._which.options = options
            path = files.get(self._which.value, next(iter(files.values())))
            tried = path, path.stat().st_mtime_ns
            if path != self._worn and tried != self._refused:
                if self._set_material(path):
                    self._worn = path
                else:
                    self._refused = tried
            sheet = self._folder / "sheets" / f"{path.stem}.png"
            logs = (self._folder / "log.jsonl", self._folder / "evaluation.jsonl")
            seen = path, *((x.stat().st_mtime_ns, x.stat().st_size) if x.exists() else None for x in (sheet, *logs))
            if seen != self._seen:
                _show(self._sheet, sheet.read_bytes() if sheet.exists() else None)
                _show(self._curves, curves(self._folder))
                self._seen = seen

    def _watch(self) -> None:
        while not self._closed.wait(EVERY):
            self.refresh()


def _show(handle: Any, png: bytes | None) -> None:
    if png is not None:
        handle.image = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
    handle.visible = png is not None
