"""`mesoshell film`: a scene over time, as frames or an MP4."""

import numpy as np

from mesoshell.cli.checks import settings_of
from mesoshell.cli.described_scene import compiled_by, is_mitsubas, scene_of
from mesoshell.cli.options.film import Options
from mesoshell.cli.progress import bar, say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.film.crew import crew_of
from mesoshell.film.keys import read_keys
from mesoshell.film.mp4 import check_mp4
from mesoshell.film.shoot import Film, plan_motion, shoot
from mesoshell.io.atomic import probe_folder, probe_outputs
from mesoshell.scene.defaults import SIZE
from mesoshell.scene.prepare import quality_of


def run(options: Options) -> None:
    """All of `mesoshell film`."""
    if is_mitsubas(options.mesh):
        raise InputError(options.mesh, "is a scene of Mitsuba's, whose camera is not moved: give its mesh")
    filmed = options.out.suffix.lower() == ".mp4"
    if filmed:
        check_mp4(options.out, options.size or SIZE, options.fps, "--out")
        probe_outputs((options.out,))
    quality = quality_of(options.quality, options.engine, settings_of(options.set))
    scene = scene_of(options)
    keys = None if options.keys is None else read_keys(options.keys)
    motion = plan_motion(scene, options.orbit, options.dolly, options.far, keys, options.wind, options.fps)
    folder = options.out.with_suffix(".frames") if filmed else options.out
    probe_folder(folder, "--out")
    crew = crew_of(options.workers, options.scheduler)
    console = stderr()
    compiled_by(options.engine)
    with bar(console, "growing") as show:
        step = lambda done, count: show(done, count, f"frame {min(int(done) + 1, count)} of {count}")  # noqa: E731
        made = shoot(scene, motion, folder, quality, options.engine, show, step, crew)
    say_notes(console, made.notes)
    if filmed:
        made.save(options.out, options.fps)
    print(f"{options.out}: {_summary(made)}")


def _summary(made: Film) -> str:
    """A film in a line."""
    count = f"{len(made.frames)} frame{'s' * (len(made.frames) != 1)}, {np.mean(made.seconds):.1f} s each"
    known = [(x, k) for k, x in enumerate(made.flicker) if x is not None]
    if not known:
        return count
    worst, at = max(known)
    return f"{count}; flicker {np.mean([x for x, _ in known]):.4f}, at most {worst:.4f} (frame {at})"
