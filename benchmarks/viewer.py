"""How soon a viewer shows what is asked: python -m benchmarks.viewer [--material NAME]

Of spot, with compiled programs in the cache, without a browser: seconds from the start of a process to the first picture,
pictures of 128 pixels a second while the camera turns (asked for after each picture, and at EVERY whether or not there was
one), seconds from a move after REST to its picture, seconds from a slider to the first picture of it, until the brush is
ready, and of a dab. Run it twice: the first fills the cache. --flip measures what pixels without rays cost the first picture.
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
    """FLIP of first pictures against 64 rays a pixel of `normal`: with all rays, half of them, and of 64 pixels, enlarged."""
    import mesoshell as ms
    from mesoshell.measure.flip import flip_map
    from mesoshell.render.quality import PRESETS
    from mesoshell.scene.accumulate import over_backdrop
    from mesoshell.scene.prepare import prepare
    from mesoshell.scene.settle import settle
    from mesoshell.viewer.look import with_size
    from mesoshell.viewer.refine import COARSE, chessboard, filled

    still = settle(ms.Scene(MESH, ms.load_material(material)))
    assert isinstance(still.camera, ms.Camera)

    def picture(side: int, quality: str, rays: int, half: bool = False) -> np.ndarray:
        scene = replace(still, camera=with_size(still.camera, side))
        passes = prepare(scene, PRESETS[quality].with_changes(density="network"), "jax").passes(None)
        known, total = chessboard(passes.shape) | (not half), np.zeros((*passes.shape, 4))
        for k in range(rays):
            total[known] += passes.render(k, np.flatnonzero(known), lambda share: None) / rays
        return filled(total, known)

    wanted = over_backdrop(picture(COARSE, "normal", 64))
    enlarged = picture(COARSE // 2, "draft", 1).repeat(2, axis=0).repeat(2, axis=1)
    shown = {"all rays": picture(COARSE, "draft", 1), "half of them": picture(COARSE, "draft", 1, half=True)}
    for name, image in (shown | {"64 pixels, enlarged": enlarged}).items():
        print(f"{name}: FLIP {flip_map(over_backdrop(image), wanted).mean():.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--material", default="turf")
    parser.add_argument("--flip", action="store_true", help="measure errors, and no times")
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
