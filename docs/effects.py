"""Effects of expanding air and of the cable's weight on vibration, calibration and recommendation.

Usage: python docs/effects.py lengths, or calibration; writes results/effects/NAME/NAME.csv (five minutes on two cores).
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.plant.calibration import Calibration, calibrate
from probe_agents.plant.inference import Case
from probe_agents.plant.recommendation import Optimum, optimal_schedule
from probe_agents.plant.response import metres_of, stored_response
from probe_agents.policies.cases import load_case
from probe_agents.policies.catalogue import named_policies
from probe_agents.policies.fixed import Scheduled
from probe_agents.records.manifest import write_json, write_manifest
from probe_agents.studies.shipped.response import Specimen, insert
from probe_env import Context, Plant, Scene, SimulatorBatch, TaskConfig
from probe_env.fidelity import PRESETS
from probe_env.physics.closed_forms import steady_root_tension

FOLDER = Path(__file__).parents[1] / "results" / "effects"
AIR, WEIGHT = {"air": {"compressible": True}}, {"contact": {"weight": True}}
EFFECTS: dict[str, dict[str, Any]] = {"neither": {}, "air": AIR, "weight": WEIGHT, "both": AIR | WEIGHT}
LENGTHS, MEMBERS = (0.5, 5.0, 10.0, 14.0, 18.0, 22.0, 30.0, 50.0), 6
SETTLE, DURATION = 3.0, 4.0  # s
TUBES = ((0.12, 1.4), (0.175, 1.2), (0.22, 2.0))  # friction, helix diameter [m]


def lengths() -> pd.DataFrame:
    """Radial rms at the sensor and root tension of every member, and the closed form of the tension."""
    rows = []
    for length in LENGTHS:
        scenes = {
            name: Scene(carrier_length=length).model_copy(
                update={**effect, "contact": {"friction": 0.175, **effect.get("contact", {})}}
            )
            for name, effect in EFFECTS.items()
        }
        batch = SimulatorBatch(
            [scene for scene in scenes.values() for _ in range(MEMBERS)], "superelement32",
            seeds=list(range(MEMBERS)) * len(scenes), perturbation=1e-7,
        )  # fmt: skip
        batch.advance(duration=SETTLE)
        statistics = batch.advance(duration=DURATION).statistics
        for k, (radial, tension) in enumerate(
            zip(statistics["radial_rms_m"], statistics["tension_mean_n"], strict=True)
        ):
            name, member = list(scenes)[k // MEMBERS], k % MEMBERS
            closed = steady_root_tension(scenes[name])
            rows.append((name, length, member, 1e3 * radial, tension, closed))
    columns = ["effects", "carrier_length_m", "member", "radial_rms_mm", "root_tension_n", "closed_form_n"]
    return pd.DataFrame(rows, columns=columns)


def calibration() -> pd.DataFrame:
    """Calibrations on logs of best-schedule with both effects, and the recommended schedules in the same tubes."""
    plain = Plant(task={"lost_drive_periods": 1000}).config
    program = named_policies(["best-schedule"], plain)["best-schedule"].schedule.at  # type: ignore[attr-defined]
    tubes = [
        Context(friction=mu, contact_stiffness=1e5, drag_factor=1.0, helix_diameter=diameter) for mu, diameter in TUBES
    ]
    specimens = [Specimen(tube, Scene().probe.damping_time) for tube in tubes]
    logs = insert(specimens, program, plain.model_copy(update={"scene": EFFECTS["both"]}), PRESETS["standard"], [0])
    task, rows = TaskConfig().model_copy(update={"scene": EFFECTS["both"]}), []
    for tube, log in zip(tubes, logs, strict=True):
        scene = Scene.fitted({"tube": {"helix_diameter": tube.helix_diameter}})
        found = calibrate([Case("log", "tube", scene, metres_of(log))], Plant(), stored_response(), progress=False)
        row: dict[str, Any] = {"helix_diameter_m": tube.helix_diameter}
        for name, truth in (("friction", tube.friction), ("drag_coefficient", 0.44)):
            draws = np.array(found.to_json()["draws"][name])
            row |= {f"{name}_true": truth, f"{name}_mean": draws.mean(), f"{name}_std": draws.std(ddof=1)}
        best = recommended(found, tube)
        row |= {"verdict": found.verdict.partition(":")[0], "reasons": "; ".join([*found.misfits, *found.at_bounds])}
        policies = {"recommended": Scheduled(task, best.schedule)} | named_policies(["best-schedule"], task)
        plan = Plan(policies, (tube,), range(MEMBERS), task, PRESETS["fast"])
        rewards = run_plan(plan, None, progress=False).pivot(index="seed", columns="policy", values="reward")
        change = rewards["recommended"] - rewards["best-schedule"]
        row |= {"expected_reward": best.reward} | {f"reward_{name}": rewards[name].mean() for name in policies}
        rows.append(row | {"gain": change.mean(), "gain_error": change.sem()})
        print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def recommended(found: Calibration, tube: Context) -> Optimum:
    """The recommendation for the posterior of a calibration, also of a misspecified one."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_json(Path(folder) / "calibration.json", found.to_json())
        plant = Plant.model_validate(
            {"tube": {"helix_diameter": tube.helix_diameter}, "posterior": f"{folder}/calibration.json"}
        )
    case = load_case(plant, "train")
    return optimal_schedule(case.contexts, stored_response(), case.config)


if __name__ == "__main__":
    part = {"lengths": lengths, "calibration": calibration}[sys.argv[1]]
    output = FOLDER / sys.argv[1]
    output.mkdir(parents=True, exist_ok=True)
    part().to_csv(output / f"{sys.argv[1]}.csv", index=False, float_format="%.6g")
    write_manifest(
        output, (f"{sys.argv[1]}.csv",), command=f"python docs/effects.py {sys.argv[1]}", seeds=range(MEMBERS)
    )
