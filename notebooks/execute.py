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


def main() -> None:
    names = sys.argv[1:] or sorted(p.name for p in FOLDER.glob("*.py") if p.name != Path(__file__).name)
    for name in names:
        if name in NEEDS_BLENDER and not (FOLDER.parent / "data_gen/.venv/installed").exists():
            print(f"{name}: skipped, no Blender environment (Python 3.11): make blender")
            continue
        notebook = jupytext.read(FOLDER / name)
        NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(FOLDER.parent)}}).execute()
        print(f"{name}: {sum(c.cell_type == 'code' for c in notebook.cells)} cells ran")


if __name__ == "__main__":
    main()
