"""README and docs/: examples run, commands, methods and public names exist, links work, the results table is stored."""

import ast
import hashlib
import json
import re
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest

from probe_agents.cli import main
from probe_agents.cli.registry import COMMANDS
from probe_agents.studies import readme
from probe_env.physics.methods import METHODS

ROOT = Path(__file__).parents[2]
PAGES = {str(path.relative_to(ROOT)): path.read_text() for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md"))}
EXAMPLES = [
    pytest.param(page, example, id=f"{page}-{k}")
    for page, text in sorted(PAGES.items())
    for k, example in enumerate(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    if not re.search(r"from (ray|minari)\b", example)  # tests/ray and tests/libraries run these
    and page != "README.md"  # tests/training/test_recipe.py
]
PACKAGES = (
    "probe_env", "probe_env.envs", "probe_env.physics", "probe_agents.policies", "probe_agents.evaluation",
    "probe_agents.plant", "probe_agents.studies",
)  # fmt: skip
"""Where users import from, with ``probe_agents.vec_env``; a package loads its modules when a name is used."""


@pytest.mark.slow
@pytest.mark.parametrize(("page", "example"), EXAMPLES)
def test_the_python_examples_run(page, example, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    exec(compile(example, page, "exec"), {"__name__": "example"})


def test_figures_of_the_readme_are_stored():
    for text in (readme.results_table(), readme.learning_table(), readme.speed_row()):
        assert text in PAGES["README.md"]


def test_citation_has_the_version_of_the_package():
    assert f"\nversion: {version('probe-env')}\n" in (ROOT / "CITATION.cff").read_text()


def test_stored_results_have_the_hashes_of_their_manifests():
    wrong = [
        f"{path.parent.relative_to(ROOT)}/{name}"
        for path in (ROOT / "results").rglob("manifest.json")
        for name, value in json.loads(path.read_text()).get("files", {}).items()
        if hashlib.sha256((path.parent / name).read_bytes()).hexdigest() != value
    ]
    assert wrong == []


def test_commands_and_methods_are_on_their_pages():
    assert [name for name in COMMANDS if f"| `{name}` |" not in PAGES["docs/commands.md"]] == []
    assert [name for name in METHODS if f"`{name}`" not in PAGES["docs/fidelity.md"]] == []


@pytest.fixture
def public():
    names = [(place, name) for place in (*PACKAGES, "probe_agents.vec_env") for name in import_module(place).__all__]
    assert len({name for _, name in names}) == len(names)  # one import path for each
    return {f"{place}.{name}" for place, name in names if name != "__version__"}


def test_public_names_are_those_of_the_api_page(public):
    entry = r"(?m)^\.\. (?:auto|py:)(?:class|function|exception|data):: (\S+)"
    entries = re.findall(entry, PAGES["docs/api.md"])
    assert sorted(entries) == sorted(public)
    for place, _, name in (path.rpartition(".") for path in entries):
        assert name in dir(import_module(place))  # for completion
        assert getattr(import_module(place), name).__doc__, name


def test_pages_import_public_names_only(public):
    for page, text in PAGES.items():
        for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            for node in ast.walk(ast.parse(example)):
                if isinstance(node, ast.ImportFrom) and node.module.startswith("probe_"):
                    assert {f"{node.module}.{alias.name}" for alias in node.names} <= public, page
                if isinstance(node, ast.Import):
                    assert not [alias.name for alias in node.names if alias.name.startswith("probe_env.")], page


def test_public_packages_load_no_agent_library():
    code = f"import sys, {', '.join(PACKAGES)}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"torch", "stable_baselines3", "matplotlib", "pandas", "pyarrow"} & set(loaded)


def test_the_commands_on_pages_exist(capsys):
    used = {name for text in PAGES.values() for name in re.findall(r"^\s*probe-env ([\w-]+)", text, re.MULTILINE)}
    assert len(used) > 10
    assert used <= set(COMMANDS)
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["evaluate", "--help"])


def test_links_between_pages_lead_somewhere():
    """As a forge shows them; the site has a check of its own."""
    for page, text in PAGES.items():
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            file, _, anchor = link.partition("#")
            target = ((ROOT / page).parent / file if file else ROOT / page).resolve()
            if not link.startswith("https://"):
                assert target.is_file(), (page, link)
                assert target.is_relative_to(ROOT), (page, link)
                assert not anchor or anchor in anchors(target.read_text()), (page, link)


def anchors(text: str) -> set[str]:
    """Anchors of a page: its headings, lower case, without punctuation, joined by hyphens."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
