"""Posterior of a calibration in the file of a plant: what it replaces, and errors."""

import json
import warnings

import gymnasium as gym
import numpy as np
import pytest

from probe_env import Plant
from probe_env.files import FileError

N = 200
RNG = np.random.default_rng(3)
FRICTION = RNG.uniform(0.12, 0.2, N)
DRAWS = {
    "friction": FRICTION.tolist(),
    "contact_stiffness": (1e5 * FRICTION / 0.16).tolist(),  # determined by the friction
    "drag_coefficient": (0.44 * RNG.uniform(0.9, 1.1, N)).tolist(),
    "damping_time": RNG.uniform(5e-5, 8e-5, N).tolist(),
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "calibration.json").write_text(json.dumps({"friction": {"mean": 0.16}, "draws": DRAWS}))
    return tmp_path


def plant_of_text(folder, text):
    (folder / "tube.toml").write_text(text)
    return Plant.from_toml(folder / "tube.toml")


def test_tubes_are_joint_draws(folder):
    """Stiffness is a function of friction, as in the draws; medians are those of the draws."""
    plant = plant_of_text(folder, 'posterior = "calibration.json"\n[tube]\nhelix_diameter = 1.4\n')
    tubes = plant.contexts(96)
    for tube in tubes:
        assert tube.contact_stiffness == pytest.approx(1e5 * tube.friction / 0.16, rel=1e-3)  # rounded to 4 digits
    # 96 points spread evenly over 200 draws: their mean is that of all draws within a spacing
    assert np.mean([t.friction for t in tubes]) == pytest.approx(FRICTION.mean(), abs=0.08 / 24)
    assert plant.scene.contact.friction == pytest.approx(np.median(FRICTION))
    assert plant.scene.probe.damping_time == pytest.approx(np.median(DRAWS["damping_time"]))
    factors = np.array([t.drag_factor for t in tubes]) * plant.scene.air.drag_coefficient
    assert set(np.round(factors, 3)) <= {round(v + d, 3) for v in DRAWS["drag_coefficient"] for d in (-1e-3, 0.0, 1e-3)}
    # draws are stored with the plant
    assert Plant.model_validate(json.loads(plant.model_dump_json())) == plant
    _, info = gym.make("probe_env/Insertion-v1", tube=plant, fidelity="fast").reset(seed=2)
    assert info["context"]["friction"] in np.round(FRICTION, 4)


def test_files_that_are_no_calibration_are_refused(tmp_path):
    for content, problem in (
        ("{", "not JSON"),
        ("[]", "draws: missing"),
        ('{"draws": {"friction": []}}', "draws.friction"),
        ('{"draws": {"friction": [0.1, 0.2], "contact_stiffness": [1e5]}}', "as many draws"),
        ('{"draws": {"friction": [0.1, 7.0]}}', "draws.friction: 7.0 is outside the accepted range 0 to 1"),
        ('{"draws": {"frction": [0.1]}}', "frction"),
        ('{"draws": {"friction": ["a"]}}', "draws.friction"),
    ):
        (tmp_path / "calibration.json").write_text(content)
        with pytest.raises(ValueError, match=problem) as error:
            plant_of_text(tmp_path, 'posterior = "calibration.json"')
        assert "\n" not in str(error.value)
        assert "tube.toml: posterior: " in str(error.value)
        assert "calibration.json: " in str(error.value)
    for name, problem in (("none.json", "no such file: "), ("a\\u0000b", "not the name of a file: .*embedded null")):
        with pytest.raises(FileError, match=f"tube.toml: posterior: .*{problem}"):
            plant_of_text(tmp_path, f'posterior = "{name}"')
    with pytest.raises(ValueError, match=r"posterior\.friction\s+.* 7\.0 is outside the accepted range 0 to 1"):
        Plant.model_validate({"posterior": {"friction": [0.1, 7.0]}})


@pytest.mark.parametrize("misspecified", [False, True])
def test_a_misspecified_calibration_warns(folder, misspecified):
    (folder / "calibration.json").write_text(json.dumps({"misspecified": misspecified, "draws": DRAWS}))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        plant_of_text(folder, 'posterior = "calibration.json"')
    assert len(caught) == misspecified
    for warning in caught:
        assert "calibration.json: the calibration is misspecified: the model does not fit" in str(warning.message)
