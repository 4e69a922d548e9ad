"""The law with integral action: what it does to the feed, its text run by an interpreter, the grid of its constants."""

import json

import numpy as np
import pytest

from agents.cli import main
from agents.plant.plc_export import structured_text
from agents.policies.catalogue import make_policy
from agents.policies.plc_law import (
    LOWERED,
    MOST_TRIM,
    NOISE_AVERAGE,
    RAISED,
    Constants,
    PlantData,
    PlcLaw,
    Trim,
    TrimmedLaw,
    read_trim,
)
from probe_env.envs.task import TaskConfig
from probe_env.files import FileError
from probe_env.physics.closed_forms import sliding_tension
from tests.oracles.structured_text import FunctionBlock, block_inputs

CONFIG = TaskConfig().all_shown
PLANT = PlantData.of(CONFIG)
TRIM = Trim(aim=4e-5, time=60.0)


def measured(noise: np.ndarray, length: np.ndarray) -> dict[str, np.ndarray]:
    """What a rig measures over periods (n,) in one tube, with steady feed, air and friction."""
    seen = {
        "inserted_length": length, "feed_speed": np.full(len(noise), 0.15), "time": np.zeros(len(noise)),
        "air_supply_rate": np.full(len(noise), 130.0 / 3600.0), "rf_noise": noise,
        "helix_diameter": np.full(len(noise), 1.2),
    }  # fmt: skip
    return seen | {"root_tension": sliding_tension(np.full(len(noise), 0.2), seen, CONFIG.scene)}


def acted(law: PlcLaw, seen: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Feed and air of each period."""
    memory = np.zeros((1, law.memory))
    law.start(memory)
    rows = ({name: values[k : k + 1] for name, values in seen.items()} for k in range(len(seen["rf_noise"])))
    pairs = [law.targets(row, memory) for row in rows]
    return np.array([feed[0] for feed, _ in pairs]), np.array([air[0] for _, air in pairs])


def test_feed_falls_and_rises_as_fast_as_its_time_says() -> None:
    """With noise far from the aim the trim is linear in time, by the least and the greatest error, up to its limit."""
    slow = Constants(slow_feed=0.1)  # far from both ends of the device's range
    law, trimmed = PlcLaw(CONFIG, slow), TrimmedLaw(CONFIG, slow, TRIM)
    settled = 10  # 2.5 time constants of the noise's average: what is left of the start is less than is cut off
    assert settled == 2.5 * NOISE_AVERAGE / CONFIG.period
    for noise, rate in ((1e-3, -LOWERED), (1e-6, RAISED)):
        seen = measured(np.full(settled + 10, noise), np.full(settled + 10, 40.0))
        by_law, air = acted(law, seen)
        by_trim, same_air = acted(trimmed, seen)
        assert (air == same_air).all()
        trim = np.log(by_trim / by_law)
        assert np.diff(trim[settled:]) == pytest.approx(rate * CONFIG.period / TRIM.time)
    long = measured(np.full(400, 1e-3), np.full(400, 40.0))
    assert np.log(acted(trimmed, long)[0] / acted(law, long)[0]).min() == pytest.approx(-MOST_TRIM)


def test_what_is_aimed_at_leaves_the_feed_and_so_does_the_length_before_the_onset() -> None:
    at_aim = measured(np.full(200, TRIM.aim), np.full(200, 40.0))
    feeds = acted(TrimmedLaw(CONFIG, trim=TRIM), at_aim)[0]
    assert feeds[100:] == pytest.approx(feeds[100], rel=1e-3)
    short = measured(np.full(200, 1e-3), np.full(200, 5.0))
    feed, air = acted(TrimmedLaw(CONFIG, Constants(shift=0.0), TRIM), short)
    assert (feed == CONFIG.feed_speeds[1]).all()
    assert (air == PLANT.air_supply_rates[0]).all()


def test_many_act_as_one() -> None:
    rng = np.random.default_rng(0)
    tubes = [measured(10.0 ** rng.uniform(-5.5, -3.5, 60), np.linspace(8.0, 50.0, 60)) for _ in range(3)]
    law = TrimmedLaw(CONFIG, trim=TRIM)
    memory = np.zeros((3, law.memory))
    law.start(memory)
    for k in range(60):
        row = {name: np.array([tube[name][k] for tube in tubes]) for name in tubes[0]}
        feed, _ = law.targets(row, memory)
    assert feed == pytest.approx([acted(law, tube)[0][-1] for tube in tubes])


@pytest.mark.parametrize("most_air", [PLANT.air_supply_rates[1], 40.0 / 3600.0])
def test_structured_text_does_what_the_policy_does(most_air: float) -> None:
    """The interpreter rounds every operation to a REAL's 24 bits. A law with no more than the least air never trims."""
    rng, count = np.random.default_rng(1), 400
    config = CONFIG.model_copy(update={"air_supply_rates": (CONFIG.air_supply_rates[0], most_air)})
    law = TrimmedLaw(config, trim=TRIM)
    block = FunctionBlock(structured_text(law.constants, PlantData.of(config), TRIM))
    assert {"AIM", "TRIM_TIME"} <= block.fixed
    seen = measured(10.0 ** rng.uniform(-5.5, -3.5, count), np.linspace(5.0, 60.0, count))
    memory, trims = np.zeros((1, law.memory)), []
    law.start(memory)
    for k in range(count):
        row = {name: values[k : k + 1] for name, values in seen.items()}
        feed, air = law.targets(row, memory)
        outputs = block(**block_inputs(row, CONFIG.period, start=k == 0))
        # 400 additions of at most 1/60, each rounded to 6e-8 of a trim of at most 0.5, and the noise's few roundings
        np.testing.assert_allclose(outputs["NoiseNow"], memory[0, -2], rtol=1e-4)
        np.testing.assert_allclose(outputs["Trim"], memory[0, -1], atol=1e-4)
        np.testing.assert_allclose([outputs["Feed"], outputs["Air"]], [feed[0], air[0]], rtol=1e-3)
        trims.append(memory[0, -1])
    assert np.ptp(trims) > 0.05 or (most_air < PLANT.air_supply_rates[1] and not np.any(trims))


def test_it_ships_by_name_and_a_damaged_file_is_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    described = make_policy("trimmed-law", CONFIG).describe()
    assert described["policy"] == "TrimmedLaw"
    assert described["aim"] == read_trim().aim
    path = tmp_path / "trim.json"
    for text, message in (
        ("{", "not the constants of a trim"), ("{}", "not the constants"),
        (json.dumps({"trim": {"aim": -1.0}}), "aim"), (json.dumps({"trim": {"tim": 1.0}}), "tim"),
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(FileError, match=message):
            read_trim(path)


def test_its_text_is_written_and_a_table_of_it_is_refused(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    assert main(["plc", "--trimmed", "--st", str(tmp_path / "law.st")]) == 0
    assert "TRIM_TIME : REAL" in (tmp_path / "law.st").read_text()
    assert "aim " in capsys.readouterr().out
    assert main(["plc", "--trimmed", "--csv", str(tmp_path / "law.csv")]) == 2
    assert "trimmed = True needs --st" in capsys.readouterr().err
