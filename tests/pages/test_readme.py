"""The README and docs/ say what the stored results say, their examples run, and their links lead somewhere."""

import os
import re
from collections import Counter
from pathlib import Path

import pytest

from agents.commands.registry import COMMANDS
from agents.pages import rewrite as readme
from agents.pages.blocks import MAKERS
from probe_env.physics.methods import METHODS

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")))
EXAMPLES = {page: re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL) for page in PAGES}
ELSEWHERE = ("docs/cluster.md",)
"""Pages whose examples need an environment of their own: tests/ray."""
LINK = re.compile(r"\]\(([^)\s]+)\)")


def test_the_pages_agree_with_the_stored_results(monkeypatch):
    monkeypatch.chdir(ROOT)
    readme.check_readme()


def test_a_changed_figure_is_noticed(monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    text = (ROOT / "docs/results/study.md").read_text()
    changed = tmp_path / "study.md"
    changed.write_text(re.sub(r"radial rms ([\d.]+),", "radial rms 9.9,", text, count=1))
    monkeypatch.setattr(readme, "_pages", lambda: {changed: ("study",)})
    with pytest.raises(ValueError, match="differs from the stored results"):
        readme.check_readme()


def test_every_block_stands_on_one_page():
    assert Counter(name for names in readme._pages().values() for name in names) == Counter(list(MAKERS))
    for page in PAGES:
        begun = re.findall(r"^<!-- (\w+) -->$", (ROOT / page).read_text(), re.MULTILINE)
        assert tuple(begun) == readme._pages().get(Path(page), ()), page


def test_the_readme_is_short_and_names_the_limit():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 150
    assert "radial rms of 0.1 mm at the sensor" in text
    header, _, *rows = [line for line in MAKERS["headline"]().splitlines() if line.startswith("|")]
    assert len(rows) <= 12
    assert header.count("|") - 1 == 2 + 5  # policy, what it does, five numbers
    limits = text.split("## Limits\n")[1].split("\n## ")[0].strip()
    assert len(limits.splitlines()) <= 8


@pytest.mark.parametrize("page", [page for page in PAGES if EXAMPLES[page] and page not in ELSEWHERE])
def test_the_python_examples_run(page, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    for example in EXAMPLES[page]:
        exec(compile(example, page, "exec"), {"__name__": "example"})
        assert capsys.readouterr().out.strip(), "an example says what it found"


def test_the_page_of_methods_says_what_each_is():
    page = (ROOT / "docs/simulation/methods.md").read_text().partition("| `method` |")[2].partition("\n\n")[0]
    assert [name for name in METHODS if f"`{name}`" not in page] == []


def test_the_readme_has_ten_lines_of_python():
    (example,) = EXAMPLES["README.md"]
    assert sum(bool(line.strip()) for line in example.splitlines()) <= 10


def test_the_commands_exist(capsys):
    from agents.cli import main

    commands = {
        name for page in PAGES for name in re.findall(r"^\s*probe-env ([\w-]+)", (ROOT / page).read_text(), re.M)
    }
    assert len(commands) > 15
    for command in sorted(commands):
        with pytest.raises(SystemExit) as done:
            main([command, "--help"])
        assert done.value.code == 0


def test_every_command_is_on_the_page_of_commands():
    page = (ROOT / "docs/commands.md").read_text()
    assert [name for name in COMMANDS if not re.search(rf"^probe-env {name}\b", page, re.M)] == []


def test_every_block_is_named_where_results_are_listed():
    """With the page that it stands on; the README's is told of below the table."""
    listed = (ROOT / "docs/results/index.md").read_text()
    for page, names in readme._pages().items():
        if page != readme.README:
            link = os.path.relpath(ROOT / page, ROOT / "docs" / "results")
            (row,) = [line for line in listed.splitlines() if re.match(rf"\| \[[^]]+\]\({re.escape(link)}[#)]", line)]
            assert set(re.findall(r"`(\w+)`", row.rsplit("|", 2)[1])) == set(names), page


@pytest.mark.parametrize("page", PAGES)
def test_links_between_pages_lead_somewhere(page):
    """As a forge shows them; the site has a check of its own."""
    for link in LINK.findall((ROOT / page).read_text()):
        if link.startswith("https://"):
            continue
        file, _, anchor = link.partition("#")
        target = (ROOT / page).parent / file if file else ROOT / page
        assert target.resolve().is_file(), link
        assert target.resolve().is_relative_to(ROOT), link
        if anchor:
            assert anchor in anchors(target.read_text()), link


def anchors(text: str) -> set[str]:
    """Places of a page: its headings, lower case, without punctuation, joined by hyphens."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_page_stands_in_a_table_of_contents():
    """As the site wants it: a page that none names fails ``make docs``, which ``make test`` does not build."""
    docs = ROOT / "docs"
    named = {docs / "index.md"}
    for page in docs.rglob("*.md"):
        for block in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(), re.DOTALL):
            lines = [line.strip() for line in block.splitlines() if line.strip() and not line.startswith(":")]
            targets = [re.sub(r".*<(.*)>", r"\1", line) for line in lines]
            named |= {(page.parent / f"{target}.md").resolve() for target in targets}
    assert {path.resolve() for path in docs.rglob("*.md")} == {path.resolve() for path in named}


def test_a_link_to_no_heading_is_noticed():
    assert anchors("# What to trust, and how far\n```sh\n# no heading\n```\n") == {"what-to-trust-and-how-far"}
