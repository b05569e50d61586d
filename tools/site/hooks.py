"""What mkdocs is told beside mkdocs.yml: pages made from docstrings and message files, and the list of decisions."""

import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
import interfaces

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "ros2_ws/src"
PACKAGES = ("stressbot_planner", "stressbot_driver")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Fill in the navigation."""
    sections = {title: entries for entry in config.nav or [] for title, entries in entry.items()}
    pages = reference()
    for package in PACKAGES:
        sections["Reference"].append({package: [path for path in pages if path.startswith(f"reference/{package}/")]})
    sections["Reference"].append({"stressbot_msgs": [path for path in pages if path.startswith("reference/stressbot_msgs/")]})
    sections["Decisions"] += [f"decisions/{path.name}" for path in sorted((ROOT / "docs/decisions").glob("*.md"))]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of the reference."""
    for path, text in reference().items():
        files.append(File.generated(config, path, content=text))
    return files


def reference() -> dict[str, str]:
    """Return the generated pages by path: one for each folder of a package, one for each interface."""
    pages = {}
    for package in PACKAGES:
        for name, modules in rooms(package).items():
            directives = "\n\n".join(f"::: {module}" for module in modules)
            pages[f"reference/{package}/{name.replace('/', '-')}.md"] = f"# {name}\n\n{directives}\n"
    for kind in interfaces.PARTS:
        for path in sorted((SOURCES / "stressbot_msgs" / kind).iterdir()):
            pages[f"reference/stressbot_msgs/{path.stem}-{kind}.md"] = interfaces.page(path)
    return pages


def rooms(package: str) -> dict[str, list[str]]:
    """Return the modules of a package by folder; those of its root under its own name."""
    folder = SOURCES / package / package
    found: dict[str, list[str]] = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        room = "/".join(parts[:-1]) or package
        names = parts[:-1] if parts[-1] == "__init__" else parts
        found.setdefault(room, []).append(".".join((package, *names)))
    return found
