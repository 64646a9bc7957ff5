"""Run the notebooks as written, from an empty folder, and keep what they show.

python .ci/site/notebooks.py FOLDER
"""

import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient


def run(path):
    """One notebook; of the run it keeps the outputs alone, neither times nor the machine."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            notebook, timeout=None, record_timing=False, resources={"metadata": {"path": folder}}
        ).execute()
    notebook.metadata.language_info = {"name": "python"}
    nbformat.write(notebook, path)
    print(path)


if __name__ == "__main__":
    for name in sorted(Path(sys.argv[1]).glob("*.ipynb")):
        run(name)
