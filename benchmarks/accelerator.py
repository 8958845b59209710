"""A training of the preset `tiny` on the accelerator that JAX finds: python -m benchmarks.accelerator

Exit status 2, and one line, if it finds none. The renders are of fog, known in closed form (tests/train/fog), so that no
Blender is needed. `make test-gpu` runs this, the hard cases and benchmarks. --find: only say what there is.
"""

import sys
import tempfile
from pathlib import Path

import jax

from mesoshell.cli.main import main as mesoshell
from mesoshell.io.dataset import read_dataset
from mesoshell.io.pack import pack_dataset
from tests.helpers import fog

SIDE = 16
MISSING = "no accelerator: JAX finds {} only; install JAX for yours, as .venv/bin/pip install -e '.[cuda]' (or .[tpu])"


def accelerator() -> str:
    """The first device, in words. Ends the program if it is a CPU."""
    device = jax.devices()[0]
    if device.platform == "cpu":
        print(f"mesoshell: {MISSING.format(device.platform)}", file=sys.stderr)
        sys.exit(2)
    return f"{len(jax.devices())} × {device.device_kind} ({device.platform}), jax {jax.__version__}"


def train_tiny(folder: Path) -> None:
    """To the end; what is not finite ends the program with status 1."""
    fog.write(folder / "fog", [(0.6, 0.3, 1.6 + 0.1 * k) for k in range(32)], size=SIDE)
    pack_dataset(read_dataset(folder / "fog"), folder / "packed")
    words = ["train", "experiments/grass.py", "--preset", "tiny", "--data", folder / "packed", "--run", folder / "run"]
    mesoshell([str(word) for word in words])


def main() -> None:
    print(accelerator(), flush=True)
    if sys.argv[1:] != ["--find"]:
        with tempfile.TemporaryDirectory() as folder:
            train_tiny(Path(folder))


if __name__ == "__main__":
    main()
