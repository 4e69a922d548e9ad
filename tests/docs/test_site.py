"""The site opens from disk: it requests nothing from other hosts, and Sphinx warns of every broken link."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
REQUEST = re.compile(
    r"""<(?:img|script|iframe|source|video)\b[^>]*\bsrc(?:set)?=["'](?:https?:)?//"""
    r"""|<link\b[^>]*href=["'](?:https?:)?//|@import\s+["'](?:https?:)?//|url\(\s*["']?(?:https?:)?//"""
    r"""|\b(?:fetch|import|importScripts|open|new (?:WebSocket|EventSource|Worker))\s*\(\s*["'`][^)]*?//"""
)
"""A page, style sheet or script that loads something from another host."""
SITE = "PROBE_ENV_SITE"
"""Environment variable that names a site that is built already; `make docs` sets it."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if SITE in os.environ:
        return ROOT / os.environ[SITE]
    if find_spec("sphinx") is None or find_spec("furo") is None or find_spec("myst_parser") is None:
        pytest.skip("Sphinx, Furo and MyST are not installed here (the extra docs): `make docs` runs this")
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(ROOT / "docs"), str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_pages_are_complete_and_request_no_other_host(site):
    files = [path for path in site.rglob("*") if path.suffix in (".html", ".css", ".js")]
    assert len(files) > 20
    assert [path.name for path in files if REQUEST.search(path.read_text(encoding="utf-8"))] == []
    for path in (ROOT / "docs").rglob("*.md"):
        page = path.relative_to(ROOT / "docs")
        assert "from code:" not in (site / page.with_suffix(".html")).read_text(), page
    assert "Episode End" in (site / "environments.html").read_text()
    assert "contact_stiffness" in (site / "api.html").read_text()
    assert "known to hold up to" in (site / "fidelity.html").read_text()
    assert "FieldInfo" not in (site / "environments.html").read_text()
    assert "pre { white-space: pre-wrap;" in (site / "_static/site.css").read_text()
    assert 'href="_static/site.css' in (site / "commands.html").read_text()


@pytest.mark.slow
def test_formulas_are_mathml(site):
    """MathML, with nothing of LaTeX in it; a dollar that is left stands for a formula that was not found."""
    drawn = 0
    for page in (ROOT / "docs").rglob("*.md"):
        text = re.sub(r"(?s)```.*?```|`[^`\n]*`", "", page.read_text())
        formulas = len(re.findall(r"(?s)\$\$.+?\$\$|\$[^$]+?\$", text))
        built = (site / page.relative_to(ROOT / "docs").with_suffix(".html")).read_text()
        math = re.findall(r"(?s)<math.*?</math>", built)
        assert len(math) == formulas, page
        assert not re.search(r"\\[a-zA-Z]", "".join(math)), page
        drawn += formulas
    assert drawn > 20


def test_requests_to_other_hosts_are_recognized():
    for text in (
        '<img src="https://example.org/picture.png">',
        '<img srcset="//example.org/picture.png 2x">',
        '<script src="https://example.org/code.js"></script>',
        '<script>fetch("https://example.org/data.json")</script>',
        '<link rel="stylesheet" href="https://example.org/style.css">',
        "<style>@import 'https://example.org/style.css';</style>",
        "@font-face { src: url('//example.org/font.woff2'); }",
        '<iframe src="https://example.org"></iframe>',
    ):
        assert REQUEST.search(text), text
    assert not REQUEST.search('<a href="https://example.org"><img src="a.png"><link rel="icon" href="b.svg">')
