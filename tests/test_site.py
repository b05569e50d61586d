"""The documentation site is built without a warning, is whole, and loads nothing from elsewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import interfaces
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
DEADLINE = 600


def build(*arguments, cwd=ROOT):
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", *arguments]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=DEADLINE)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = build("--site-dir", folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.xdist_group("site")
def test_every_page_message_and_module_is_on_the_site(site):
    pages = {str(path.relative_to(site).with_suffix("")) for path in site.rglob("*.html")}
    wanted = {str(path.relative_to(ROOT / "docs").with_suffix("")) for path in (ROOT / "docs").rglob("*.md")}
    messages = [path for kind in interfaces.PARTS for path in (ROOT / "ros2_ws/src/stressbot_msgs" / kind).iterdir()]
    wanted |= {f"reference/stressbot_msgs/{path.stem}-{path.suffix[1:]}" for path in messages}
    assert len(wanted) > 50 and wanted <= pages
    text = "".join(path.read_text(encoding="utf-8") for path in site.glob("reference/stressbot_*/*.html"))
    for package in ("stressbot_planner", "stressbot_driver"):
        folder = ROOT / "ros2_ws/src" / package / package
        for path in folder.rglob("*.py"):
            name = ".".join((package, *path.relative_to(folder).with_suffix("").parts)).removesuffix(".__init__")
            assert f'id="{name}"' in text, name


@pytest.mark.xdist_group("site")
def test_nothing_is_loaded_from_elsewhere(site):
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"?(https?:[^\"> ]*)", text)
        loaded += re.findall(r"<link\b[^>]*\bhref=\"?(https?:[^\"> ]*)", text)
        assert not loaded, path.name
    assert not [path for path in site.rglob("*.css") if re.search(r"url\([\"']?https?:|@import", path.read_text(encoding="utf-8"))]


def test_a_link_that_leads_nowhere_fails_the_build(tmp_path):
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    kept = {name: settings[name] for name in ("site_name", "validation")}
    (tmp_path / "docs").mkdir()
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(kept | {"plugins": []}), encoding="utf-8")
    page = tmp_path / "docs/index.md"
    page.write_text("[there](index.md)\n", encoding="utf-8")
    assert build(cwd=tmp_path).returncode == 0
    for target in ("missing.md", "index.md#nothing"):
        page.write_text(f"[nowhere]({target})\n", encoding="utf-8")
        done = build(cwd=tmp_path)
        assert done.returncode == 1 and target.split("#")[-1] in done.stdout + done.stderr, done


@pytest.mark.parametrize("kind", interfaces.PARTS)
def test_a_page_of_an_interface_lists_every_field(kind):
    for path in (ROOT / "ros2_ws/src/stressbot_msgs" / kind).iterdir():
        text = interfaces.page(path)
        lines = [line.split("#")[0].split() for line in path.read_text(encoding="utf-8").splitlines()]
        for words in lines:
            if len(words) > 1:
                name = words[1].split("=")[0]
                assert re.search(rf"\| `{re.escape(words[0])}` \| `{name}` \|", text), (path.name, words)


def test_a_line_that_is_no_field_is_refused(tmp_path):
    path = tmp_path / "Odd.msg"
    path.write_text("float64\n", encoding="utf-8")
    with pytest.raises(ValueError, match="Odd.msg: no field: float64"):
        interfaces.page(path)
