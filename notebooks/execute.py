"""Execute every notebook of this folder from top to bottom: python notebooks/execute.py [NAME ...]

Notebooks are kept as text (jupytext's percent format). A cell that raises fails the run and names the notebook. One that
needs Blender is skipped, and says so, where Blender's environment is missing.
"""

import sys
from pathlib import Path

import jupytext
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
NEEDS_BLENDER = {"atlas.py", "datasets.py"}


NOTEBOOKS = sorted(p.name for p in FOLDER.glob("*.py") if p.name != Path(__file__).name)
NO_BLENDER = "no Blender environment (Python 3.11): make blender"


def can_run(name: str) -> bool:
    """Whether what a notebook needs is there."""
    return name not in NEEDS_BLENDER or (FOLDER.parent / "data_gen/.venv/installed").exists()


def execute(name: str) -> int:
    """Run a notebook's cells, and say how many there are. Raises CellExecutionError at the first that fails."""
    notebook = jupytext.read(FOLDER / name)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(FOLDER.parent)}}).execute()
    return sum(c.cell_type == "code" for c in notebook.cells)


def main() -> None:
    for name in sys.argv[1:] or NOTEBOOKS:
        print(f"{name}: {f'{execute(name)} cells ran' if can_run(name) else f'skipped, {NO_BLENDER}'}")


if __name__ == "__main__":
    main()
