"""What ships is found by name, in a checkout as in an installed package; a path that exists wins."""

import shutil
from pathlib import Path

import pytest

from probe_agents.policies.catalogue import NAMES
from probe_agents.records import shipped
from probe_agents.records.shipped import file_or_shipped, policy_file, shipped_agents, shipped_names

ROOT = Path(__file__).parents[2]


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The folder of a package as it is installed, with little in it."""
    package = tmp_path / "site" / "agents" / "probe_agents"
    agents = (f"results/agents/ppo/seed-{seed}/agent.safetensors" for seed in (0, 3))
    for source in (*agents, "configs/scenes/fig11_l10.toml", "configs/schedules/example.csv"):
        place = package / "shipped" / source.removeprefix("results/").removeprefix("configs/")
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / source, place)
    monkeypatch.setattr(shipped, "PACKAGE", package)
    return package


def test_a_checkout_ships_what_it_holds():
    assert shipped_agents() == dict.fromkeys(("ppo", "student"), (0, 1, 2, 3, 4))
    assert all(shipped.DEFAULT_SEED in seeds for seeds in shipped_agents().values())
    names = [*NAMES, *shipped_agents(), *shipped_names("schedules")]
    assert len(set(names)) == len(names)  # none stands for two policies
    assert shipped_names("train") == tuple(shipped_agents())  # each is how its agents were made
    assert {"original", "improved"} <= set(shipped_names("design"))
    for spec, seed in (("ppo", 0), ("ppo@2", 2)):
        assert policy_file(spec) == str(ROOT / f"results/agents/ppo/seed-{seed}/agent.safetensors")
    assert file_or_shipped("scenes", "fig11_l10") == ROOT / "configs" / "scenes" / "fig11_l10.toml"


def test_an_installed_package_ships_its_own(installed):
    folder = installed / "shipped"
    assert shipped_agents() == {"ppo": (0, 3)}
    assert policy_file("ppo@3") == str(folder / "agents" / "ppo" / "seed-3" / "agent.safetensors")
    for name in ("example", "example.csv"):
        assert policy_file(name) == str(folder / "schedules" / "example.csv")
    assert policy_file("pi") == "pi"
    with pytest.raises(ValueError, match="policy = 'ppo@1': the training seeds of ppo are 0, 3"):
        policy_file("ppo@1")
    with pytest.raises(FileNotFoundError) as caught:
        file_or_shipped("scenes", "fig11")
    assert (caught.value.filename, caught.value.hint) == ("fig11", "shipped scenes: fig11_l10")


def test_a_path_that_exists_wins_and_a_folder_is_none(installed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("fig11_l10").mkdir()
    assert file_or_shipped("scenes", "fig11_l10").parent == installed / "shipped" / "scenes"
    for name in ("fig11_l10.toml", "example.csv"):
        Path(name).touch()
    assert file_or_shipped("scenes", "fig11_l10.toml") == Path("fig11_l10.toml")
    assert policy_file("example.csv") == "example.csv"
