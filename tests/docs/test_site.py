"""The site opens from disk: nothing comes from outside, and every link leads somewhere."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from links import problems

ROOT = Path(__file__).parents[2]
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
def test_every_page_is_built_and_every_link_leads_somewhere(site):
    """Nothing comes from outside, and what stands for code is filled in."""
    assert problems(site) == []
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
def test_formulas_are_drawn_by_the_browser_and_none_is_left_as_text(site):
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


GOOD = '<html><body><h1 id="top">A</h1><a href="b.html#place">b</a><a href="https://example.org">out</a></body></html>'
WRONG = [
    ('<a href="c.html">', "c.html, which is not there"),
    ('<a href="b.html#nowhere">', "b.html has no such place"),
    ('<a href="#nowhere">', "a.html has no such place"),
    ('<a href="/b.html">', "not relative"),
    ('<a href="../outside.html">', "not there"),
    ('<img src="picture.png">', "picture.png, which is not there"),
    ('<img src="https://example.org/picture.png">', "from outside"),
    ('<img srcset="//example.org/picture.png 2x">', "from outside"),
    ('<script src="https://example.org/code.js"></script>', "from outside"),
    ('<script>fetch("https://example.org/data.json")</script>', "asks outside"),
    ('<link rel="stylesheet" href="https://example.org/style.css">', "from outside"),
    ('<link rel="preconnect" href="https://example.org">', "from outside"),
    ("<style>@import 'https://example.org/style.css';</style>", "from outside"),
    ('<p style="background: url(https://example.org/picture.png)">', "from outside"),
    ('<iframe src="https://example.org"></iframe>', "from outside"),
]
STYLES = ("@font-face { src: url('//example.org/font.woff2'); }", "p { background: url(gone.png) }")


def test_what_is_wrong_with_a_page_or_a_style_sheet_is_noticed(tmp_path):
    assert problems(tmp_path) == [f"{tmp_path}: no pages"]
    (tmp_path / "site").mkdir()
    (tmp_path / "outside.html").write_text(GOOD)
    (tmp_path / "site/b.html").write_text('<p id="place">')
    (tmp_path / "site/a.html").write_text(GOOD)
    assert problems(tmp_path / "site") == []
    for wrong, message in WRONG:
        (tmp_path / "site/a.html").write_text(GOOD.replace("</body>", f"{wrong}</body>"))
        (fault,) = problems(tmp_path / "site")
        assert message in fault
    (tmp_path / "site/a.html").write_text(GOOD)
    for style in STYLES:
        (tmp_path / "site/style.css").write_text(style)
        assert len(problems(tmp_path / "site")) == 1
