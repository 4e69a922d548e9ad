"""RL Baselines3 Zoo trains with the settings of the page, in a Python environment of its own."""

import re
import subprocess
import sys
from pathlib import Path

from stable_baselines3 import PPO

PAGE = Path(__file__).parents[2] / "docs" / "policies.md"


def test_the_command_of_the_page_trains(tmp_path):
    text = PAGE.read_text()
    (settings,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    (command,) = re.findall(r"^python -m rl_zoo3.train .*", text, re.MULTILINE)
    (tmp_path / "zoo.yml").write_text(settings)
    arguments = [*command.split()[1:], "--n-timesteps", "512", "--log-folder", str(tmp_path / "logs")]
    subprocess.run([sys.executable, *arguments], cwd=tmp_path, check=True)
    (model,) = (tmp_path / "logs").rglob("probe_env-*.zip")
    assert PPO.load(model, device="cpu").num_timesteps == 2048  # one rollout
