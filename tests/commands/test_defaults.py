"""Where commands read and write if they are not told: never over a file that ships."""

from pathlib import Path

import pytest

from agents.cli import main

ROOT = Path(__file__).parents[2]
SNR = ROOT / "configs" / "tubes" / "snr.toml"


@pytest.fixture
def maps(monkeypatch):
    """Targets of the maps that are asked for; none is made."""
    pytest.importorskip("torch")
    targets = []
    monkeypatch.setattr(
        "agents.policies.maps.fit.make_map", lambda seeds, output, target, plant: targets.append(target)
    )
    return targets


@pytest.mark.parametrize("tube", ["snr", str(SNR), "configs/tubes/snr.toml", "configs/design/../tubes/snr.toml"])
def test_the_map_of_a_tube_that_ships_stays(tube, maps, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert main(["map", "--tube", tube]) == 0
    assert maps == [Path("output/map/vibration-map.npz")]
    assert f"{tube} ships, and its map stays: the new one is output/map/vibration-map.npz" in capsys.readouterr().err


def test_the_map_of_ones_own_tube_goes_beside_its_file_and_any_where_it_is_asked_to(maps, tmp_path, capsys):
    (tmp_path / "mine.toml").write_text(SNR.read_text())
    assert main(["map", "--tube", str(tmp_path / "mine.toml")]) == 0
    assert main(["map", "--tube", str(SNR), "--target", str(tmp_path / "other.npz")]) == 0  # as the stage does
    assert maps == [tmp_path / "mine-map.npz", tmp_path / "other.npz"]
    assert capsys.readouterr().err == ""
