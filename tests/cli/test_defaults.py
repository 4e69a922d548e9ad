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
        "agents.studies.shipped.vibration_map.make_map", lambda seeds, request, target: targets.append(target)
    )
    return targets


@pytest.mark.parametrize("tube", ["snr", str(SNR), "configs/tubes/snr.toml", "configs/design/../tubes/snr.toml"])
def test_the_map_of_a_tube_that_ships_stays(tube, maps, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert main(["study", "vibration-map", "--tube", tube]) == 0
    assert maps == [Path("output/vibration-map/vibration-map.npz")]
    assert (
        f"{tube} ships, and its map stays: the new one is output/vibration-map/vibration-map.npz"
        in capsys.readouterr().err
    )


def test_the_map_of_ones_own_tube_goes_beside_its_file(maps, tmp_path, capsys):
    (tmp_path / "mine.toml").write_text(SNR.read_text())
    assert main(["study", "vibration-map", "--tube", str(tmp_path / "mine.toml")]) == 0
    assert maps == [tmp_path / "mine-map.npz"]
    assert capsys.readouterr().err == ""
