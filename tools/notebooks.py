"""Execute the notebooks of examples/ and store what they show: `make notebook`."""

import argparse
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
TIMEOUT = 600
"""s for a cell."""

LARGEST = 300_000
"""Bytes of a notebook with its outputs."""


def execute(path: Path) -> nbformat.NotebookNode:
    """Return a notebook with fresh outputs, without times and versions, which would change with every run.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell fails.
    """
    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(path.parent)}}
    # A kernel may send what a cell prints in one message or in several.
    NotebookClient(notebook, timeout=TIMEOUT, resources=resources, record_timing=False, coalesce_streams=True).execute()
    notebook.metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return notebook


def main() -> None:
    """Execute the notebooks that are named, or all."""
    parser = argparse.ArgumentParser(prog="notebooks", description="Execute the notebooks of examples/.")
    parser.add_argument("notebooks", nargs="*", type=Path, help="default: all")
    for path in parser.parse_args().notebooks or sorted(EXAMPLES.glob("*.ipynb")):
        nbformat.write(execute(path), path)
        size = path.stat().st_size
        if size > LARGEST:
            sys.exit(f"notebooks: {path.name} has {size} bytes, more than {LARGEST}: show less")
        print(f"{path.name}: {size // 1000} kB", flush=True)


if __name__ == "__main__":
    main()
