"""The README says what the stored results say, and its example runs."""

import re
from pathlib import Path

import pytest

from agents.pages import rewrite as readme

ROOT = Path(__file__).parents[2]


def test_the_readme_agrees_with_the_stored_results(monkeypatch):
    monkeypatch.chdir(ROOT)
    readme.check_readme()


def test_a_changed_figure_is_noticed(monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    text = (ROOT / "README.md").read_text()
    changed = tmp_path / "README.md"
    changed.write_text(re.sub(r"radial rms ([\d.]+),", "radial rms 9.9,", text, count=1))
    monkeypatch.setattr(readme, "_pages", lambda: {changed: ("study",)})
    with pytest.raises(ValueError, match="differs from the stored results"):
        readme.check_readme()


def test_the_python_examples_run(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(examples) == 3
    for example in examples:
        exec(compile(example, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "radial rms at the sensor" in printed
    assert "False" in printed  # nothing diverged
    assert "reward of the first probe" in printed
    assert (tmp_path / "slower.toml").exists()


def test_the_commands_exist(capsys):
    from agents.cli import main

    commands = set(re.findall(r"^probe-env (\w+)", (ROOT / "README.md").read_text(), re.MULTILINE))
    assert commands
    for command in sorted(commands):
        with pytest.raises(SystemExit) as done:
            main([command, "--help"])
        assert done.value.code == 0
