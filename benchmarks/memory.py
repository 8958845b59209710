"""Peak memory of a render by image size, each in a process of its own: python -m benchmarks.memory"""

import resource
import subprocess
import sys

SIZES = (512, 1024, 2048)


def one(size: int) -> None:
    from benchmarks.scenes import spot
    from mesoshell.render.effects import plan_effects
    from mesoshell.render.quality import PRESETS
    from mesoshell.scene.render_shell import facts
    from mesoshell.shell.render.renderer import render

    scene, quality = spot(size), PRESETS["draft"]
    render(scene, quality, plan_effects(facts(scene), quality))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)


def main() -> None:
    if len(sys.argv) > 1:
        one(int(sys.argv[1]))
        return
    print("| size | peak memory, MiB |\n|---|---|")
    for size in SIZES:
        command = [sys.executable, "-m", "benchmarks.memory", str(size)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        print(f"| {size}² | {done.stdout.strip()} |")


if __name__ == "__main__":
    main()
