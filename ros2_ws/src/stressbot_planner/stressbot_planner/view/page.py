"""The page as one HTML file, out of the files in `page/`: with data inside it stands alone, and works from a disk."""

import base64
import hashlib
import re
from functools import cache
from importlib import resources
from typing import Any

from stressbot_planner.view.board import compact

_SCRIPT = re.compile(r'<script src="([\w.]+)"( data-live)?></script>\n')
_STYLE = re.compile(r'<link rel="stylesheet" href="([\w.]+)">\n')


def live() -> str:
    """Return the page that talks to the server it came from."""
    return _assembled(None)


def alone(data: dict[str, Any]) -> str:
    """Return the page of a plan or a recording that needs nobody.

    Args:
        data: contents by kind, as on a board.
    """
    return _assembled(data)


def policy(html: str) -> str:
    """Return the content security policy of a page: its own script and style, its own server, and nothing else."""
    hashes = {
        kind: " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in texts)
        for kind, texts in (
            ("script", re.findall(r"<script>(.*?)</script>", html, re.DOTALL)),
            ("style", re.findall(r"<style>(.*?)</style>", html, re.DOTALL)),
        )
    }
    return (
        f"default-src 'none'; script-src {hashes['script']}; style-src {hashes['style']}; connect-src 'self'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def _assembled(data: dict[str, Any] | None) -> str:
    """Put style and scripts into the page, in their order; without a server, not what talks to one."""
    html = _file("index.html")
    scripts = [name for name, is_live in _SCRIPT.findall(html) if data is None or not is_live]
    code = "".join(_file(name) for name in scripts)
    html = _STYLE.sub(lambda match: f"<style>{_file(match[1])}</style>\n", html)
    first = True

    def script(_match: re.Match) -> str:
        nonlocal first
        text, first = f'<script>"use strict";\n{code}</script>\n' if first else "", False
        return text

    html = _SCRIPT.sub(script, html)
    if data is None:
        return html
    inside = compact(data).replace("<", "\\u003c")
    safe = f'<meta http-equiv="Content-Security-Policy" content="{policy(html)}">\n'
    html = html.replace("<title>", f"{safe}<title>", 1)
    return html.replace("</head>", f'<script type="application/json" id="data">{inside}</script>\n</head>', 1)


@cache
def _file(name: str) -> str:
    """Return a file; of scripts and styles without indentation and the comments that have a line of their own."""
    text = (resources.files("stressbot_planner.view") / "page" / name).read_text(encoding="utf-8")
    if name.endswith(".html"):
        return text
    lines = (line.strip() for line in text.splitlines())
    return "".join(f"{line}\n" for line in lines if line and not line.startswith("//"))
