"""How soon a viewer shows what is asked: python -m benchmarks.viewer [--material NAME]

Of spot, with compiled programs in the cache, without a browser: seconds from the start of a process to the first picture,
pictures of 128 pixels a second while the camera turns (asked for after each picture, and at EVERY whether or not there was
one), seconds from a move after REST to its picture, seconds from a slider to the first picture of it, until the brush is
ready, and of a dab. Run it twice: the first fills the cache. --flip measures what
the first picture loses by its few rays and samples, and what it gains.
"""

import argparse
import itertools
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np

MESH = "tests/data/spot.obj"
MOVES = 12
#: Seconds between moves of a camera that is dragged; of rest, in which the picture refines; of dragging.
EVERY, REST, DRAG = 0.02, 2.0, 4.0


def measured(material: str) -> None:
    """All of it, in this process, which has just begun."""
    begin = time.perf_counter()
    import jax

    import mesoshell as ms
    from mesoshell.film.motion import rotate_about
    from mesoshell.io.cache import cache_folder
    from mesoshell.viewer.canvas import Canvas
    from mesoshell.viewer.strokes import RADII
    from mesoshell.viewer.work import Workshop

    jax.config.update("jax_compilation_cache_dir", str(cache_folder("xla")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    shown = threading.Semaphore(0)

    def show(eye: object) -> None:
        shown.release()

    def wait() -> float:
        """Seconds to the next picture of what is wished for; further ones are forgotten."""
        since = time.perf_counter()
        shown.acquire()
        while not work.picture(1)[1]:
            shown.acquire()
        seconds = time.perf_counter() - since
        while shown.acquire(blocking=False):
            pass
        return seconds

    work = Workshop(ms.Scene(MESH, ms.load_material(material)), show, lambda line: None, lambda share: None)
    camera = work.still.camera
    assert isinstance(camera, ms.Camera)
    work.see(1, camera)
    wait()
    print(f"first picture {time.perf_counter() - begin:.1f} s after the start")
    moves = []
    for k in range(MOVES):
        work.see(1, rotate_about(camera, np.zeros(3), 1, 0.05 * k))
        moves.append(wait())
    print(f"{1 / np.median(moves):.1f} pictures a second while the camera turns")
    rests = []
    for k in range(3):
        time.sleep(REST)
        while shown.acquire(blocking=False):
            pass
        work.see(1, rotate_about(camera, np.zeros(3), 1, 0.05 * k))
        rests.append(wait())
    print(f"{np.median(rests):.2f} s from a move after a rest to its picture")
    count, end = 0, time.perf_counter() + DRAG
    for k in itertools.count():
        if time.perf_counter() > end:
            break
        work.see(1, rotate_about(camera, np.zeros(3), 1, 0.01 * k))
        time.sleep(EVERY)
        while shown.acquire(blocking=False):
            count += 1
    print(f"{count / DRAG:.1f} pictures a second while it is dragged")
    wait()
    waits = []
    for k in range(MOVES):
        name, value = next(iter(work.look.params.items()))
        parameter = work.begun.material.parameters[name]
        low, high = parameter.range
        work.set(
            replace(work.look, params={**work.look.params, name: low + (high - low) * ((value + 0.1 * (k + 1)) % 1)})
        )
        waits.append(wait())
    print(f"{np.median(waits):.2f} s from a slider to its picture")
    work.close()
    begin = time.perf_counter()
    canvas = Canvas(work.still.mesh, work.look.thickness or 0.0)  # type: ignore[arg-type]
    canvas.prepare()
    print(f"{time.perf_counter() - begin:.1f} s until the brush is ready")
    hit = canvas.hit(camera.to_world[:3, 3], -camera.to_world[:3, 2])
    assert hit is not None
    image = np.zeros(canvas.shape, np.float32)
    for radius in RADII:
        dabs = []
        for _ in range(MOVES):
            begin = time.perf_counter()
            image = canvas.dab(image, hit, radius * canvas.size, 1.0)
            dabs.append(time.perf_counter() - begin)
        print(f"{1000 * np.median(dabs):.0f} ms a dab of radius {radius}")


def flip(material: str) -> None:
    """FLIP against 64 rays a pixel of `normal`, and time, of first pictures: as they are, with all rays, with a draft's
    samples, and of half as many pixels a side."""
    import mesoshell as ms
    from mesoshell.measure.flip import flip_map
    from mesoshell.render.quality import PRESETS, Quality
    from mesoshell.scene.accumulate import over_backdrop
    from mesoshell.scene.picture import Passes
    from mesoshell.scene.prepare import prepare
    from mesoshell.scene.settle import settle
    from mesoshell.viewer.look import with_size
    from mesoshell.viewer.refine import COARSE, chessboard, filled, first_settings

    still = settle(ms.Scene(MESH, ms.load_material(material)))

    def passes(side: int, quality: Quality) -> Passes:
        assert isinstance(still.camera, ms.Camera)
        scene = replace(still, camera=with_size(still.camera, side))
        return prepare(scene, quality.with_changes(density="network"), "jax").passes(None)

    def picture(of: Passes, rays: int, half: bool) -> np.ndarray:
        known, total = chessboard(of.shape) | (not half), np.zeros((*of.shape, 4))
        for k in range(rays):
            total[known] += of.render(k, np.flatnonzero(known), lambda share: None) / rays
        larger = COARSE // of.shape[0]
        return over_backdrop(filled(total, known).repeat(larger, axis=0).repeat(larger, axis=1))

    wanted, few = picture(passes(COARSE, PRESETS["normal"]), 64, False), first_settings()
    shown = {
        "the first picture": (passes(COARSE, few), 1, True),
        "with all rays": (passes(COARSE, few), 1, False),
        "with a draft's samples": (passes(COARSE, PRESETS["draft"]), 1, True),
        "of 64 pixels, enlarged": (passes(COARSE // 2, few), 1, False),
    }
    errors = {name: flip_map(picture(*one), wanted).mean() for name, one in shown.items()}
    times: dict[str, list[float]] = {name: [] for name in shown}
    for _ in range(MOVES):
        for name, one in shown.items():
            begin = time.perf_counter()
            picture(*one)
            times[name].append(time.perf_counter() - begin)
    least = np.median(times["the first picture"])
    for name, error in errors.items():
        print(f"{name}: FLIP {error:.3f}, {np.median(times[name]) / least:.2f} of the time")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--material", default="turf")
    parser.add_argument("--flip", action="store_true", help="measure what first pictures cost")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.flip:
        flip(given.material)
    elif given.here:
        measured(given.material)
    else:
        subprocess.run([sys.executable, "-m", __spec__.name, "--material", given.material, "--here"], check=True)


if __name__ == "__main__":
    main()
