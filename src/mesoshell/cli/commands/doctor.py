"""`mesoshell doctor`: what is installed here, and what each missing part would need."""

import importlib.metadata
import importlib.util
import os
import signal
import subprocess
import sys

from mesoshell.cli.options.doctor import Options
from mesoshell.datasets.blender.process import blender_command
from mesoshell.errors import InputError
from mesoshell.io.cache import ROOMS, cache_folder, held, remove


def run(options: Options) -> None:
    """All of `mesoshell doctor`."""
    print(f"python      {sys.version.split()[0]} on {os.cpu_count()} processors")
    for name in ("numpy", "jax", "jaxlib", "trimesh", "embreex", "xatlas", "OpenEXR"):
        try:
            print(f"{name:<11} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            print(f"{name:<11} missing: pip install mesoshell")
    print(f"devices     {_probe('import jax; print(*jax.devices())')}")
    print(f"embree      {_probe(_RAY)}")
    print(f"grass       {_probe(_BUNDLE)}")
    say_kept(options.clear)
    if importlib.util.find_spec("mitsuba"):
        print(f"mitsuba     {_probe(_PATHS)}")
    else:
        print(
            "mitsuba     not installed (only `mesoshell render --engine mitsuba` needs it): pip install mesoshell[mitsuba]"
        )
    try:
        (python, *_), _ = blender_command()
        print(f"blender     {_probe('import bpy; print(bpy.app.version_string)', python)}")
    except (InputError, OSError):
        print("blender     no environment here (only `mesoshell dataset render` needs it): make blender")


def say_kept(clear: bool) -> None:
    """Say what is kept on the disk; remove it first if told so."""
    rooms = {cache_folder(room): what for room, what in ROOMS.items()}
    if clear:
        for room in rooms:
            remove(room)
    sizes = [f"{held(room) / 1e6:.0f} MB of {what}" for room, what in rooms.items()]
    print(f"kept        in {cache_folder('xla').parent}: {', '.join(sizes)}")


_RAY = """
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
scene = EmbreeScene()
TriangleMesh(scene, np.float32([[[0, 0, 1], [1, 0, 1], [0, 1, 1]]]))
hit = scene.run(np.float32([[0.2, 0.2, 0]]), np.float32([[0, 0, 1]]))
print("a test ray hits" if hit[0] == 0 else "a test ray misses what it should hit")
"""

_BUNDLE = """
from mesoshell.io.material import find
from mesoshell.io.bundle import read_bundle
path = find("grass")
print(f"{path.stat().st_size / 1e6:.1f} MB, parameters:", ", ".join(p.name for p in read_bundle(path).parameters) or "none")
"""


_PATHS = """
import mesoshell.pathtracer
import os, mitsuba as mi, numpy as np
parts = {"integrator": {"type": "path"}, "light": {"type": "constant"}, "sensor": {"type": "perspective"}}
scene = mi.load_dict({"type": "scene"} | parts)
mean = np.array(mi.render(scene, spp=1)).mean()
where = os.environ.get("DRJIT_LIBLLVM_PATH", "the system's libLLVM")
print(f"{mi.__version__}, {mi.variant()}, {where}" if abs(mean - 1) < 1e-3 else f"renders {mean:.3f} where 1 was due")
"""


def _probe(code: str, python: str = sys.executable) -> str:
    """Run code in a process of its own, so that an abort does not end this one."""
    done = subprocess.run([python, "-c", code], capture_output=True, text=True)
    lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    last = lines[-1] if lines else f"no answer, exit status {done.returncode}"
    if done.returncode < 0:
        last = f"ended by {signal.Signals(-done.returncode).name}: {last}"
    return last if done.returncode == 0 else f"does not work: {last}"
