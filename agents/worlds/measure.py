"""What the map leaves out, found on recorded insertions, and how far rewards in its world are from simulated ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import kendalltau
from tqdm import tqdm

from agents.policies.catalogue import named_policies
from agents.policies.maps.vibration_map import CONTEXT, VibrationMap, stored_map
from agents.policies.places import place_of
from agents.records.provenance import provenance, write_atomically, write_json
from agents.records.reading import read_csv
from agents.rollouts.statistics import mean_interval
from agents.studies.shipped.vibration_map import Wandering
from agents.worlds.map_episodes import MapEpisodes
from agents.worlds.noise import STORED, Noise, Scatter, features
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.trials import periods_of
from probe_env.physics.closed_forms import sliding_tension

RECORDED: Final = (
    "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "radial_acceleration_rms_m_per_s2",
    "axial_acceleration_rms_m_per_s2", "tension_mean_n",
)  # fmt: skip
FAR: Final = 8
"""[periods] over which what lasts is told from what changes from one to the next."""
POLICIES: Final = (
    "constant", "slow-down", "pi", "best-constant", "best-schedule", "best-schedule-by-diameter", "tension-scheduled",
    "adaptive", "privileged", "ppo", "ppo-no-tension",
)  # fmt: skip
DEEP: Final = 15.0
"""[m] from which the tension is compared: before, the closed form has little to go by."""


def record_insertions(limit: int) -> pd.DataFrame:
    """Wandering insertions of training tubes at ``fast``, a row a period: ``RECORDED``, ``CONTEXT`` and the episode."""
    place = place_of(None, "train", limit)
    config, rows = place.config.all_shown, []
    episodes = Episodes(limit, config, fidelity="fast")
    options = {k: {"context": context} for k, context in enumerate(place.contexts)}
    observation, _ = episodes.reset(range(limit), {k: np.random.default_rng([7, k]) for k in range(limit)}, options)
    policies = [Wandering(config, seed=7) for _ in range(limit)]
    with tqdm(total=limit, desc="insertions") as bar:
        for step, active in periods_of(episodes, policies, observation):
            assert episodes.window is not None
            axial = episodes.window.statistics[RECORDED[5]]
            for k in np.flatnonzero(active).tolist():
                info = step.infos[k] | {RECORDED[5]: float(axial[k])}
                tube = {name: getattr(place.contexts[k], name) for name in CONTEXT}
                rows.append({"episode": k} | {name: info[name] for name in RECORDED} | tube)
            bar.update(int((active & ~episodes.running).sum()))
    return pd.DataFrame(rows)


def noise_of(rows: pd.DataFrame, vibration: VibrationMap) -> Noise:
    """What the map leaves out of recorded insertions, see ``record_insertions``."""
    config = place_of(None, "train", 1).config
    tubes, (length, feed, air) = rows[list(CONTEXT)].to_numpy(), (rows[name].to_numpy() for name in RECORDED[:3])
    vibrated = np.log10(np.maximum(rows["radial_rms_m"].to_numpy(), 1e-7) / 1e-4)
    rest = vibrated - vibration.tells(length, feed, air, tubes, config.scene)[0]
    bias = float(rest.mean())
    slow = Scatter.of(_by_episode(rows, rest - bias), FAR)
    quick = float(np.sqrt(max(rest.var() - slow.deviation**2, 0.0)))
    seen = {"inserted_length": length, "feed_speed": feed, "air_supply_rate": air, "helix_diameter": tubes[:, 3]}
    pulled = sliding_tension(tubes[:, 0], seen, config.scene) * tubes[:, 2]
    deep = rows[length > DEEP]
    share = np.log(np.maximum(rows["tension_mean_n"].to_numpy() / pulled, 0.05))[length > DEEP]
    radial, axial = (_felt(rows, column, features(vibrated, feed, length, tubes)) for column in RECORDED[4:6])
    tension = Scatter.of(_by_episode(deep, share - share.mean()))
    return Noise(
        bias=bias, slow=slow, quick=quick, tension=tension,
        radial=radial[0], radial_scatter=radial[1], axial=axial[0], axial_scatter=axial[1],
    )  # fmt: skip


def _felt(rows: pd.DataFrame, column: str, inputs: FloatArray) -> tuple[tuple[float, ...], Scatter]:
    """Coefficients of an acceleration's logarithm, and what they leave."""
    felt = np.log10(np.maximum(rows[column].to_numpy(), 1e-3))
    coefficients = np.linalg.lstsq(inputs, felt, rcond=None)[0]
    rounded = tuple(float(f"{c:.4g}") for c in coefficients)
    return rounded, Scatter.of(_by_episode(rows, felt - inputs @ coefficients))


def _by_episode(rows: pd.DataFrame, values: FloatArray) -> list[FloatArray]:
    episode = rows["episode"].to_numpy()
    return [values[episode == k] for k in np.unique(episode)]


def rewards_in_the_map(names: tuple[str, ...], noise: Noise | None = None, limit: int = 0) -> pd.DataFrame:
    """Rewards of policies on the test tubes in the world of the map: policy, context, reward."""
    place, rows = place_of(None, "test", limit), []
    config, count = place.config.all_shown, len(place.contexts)
    for name, policy in named_policies(names, config).items():
        episodes = MapEpisodes(count, config, noise=noise)
        options = {k: {"context": context} for k, context in enumerate(place.contexts)}
        rngs = {k: np.random.default_rng([0, k]) for k in range(count)}
        observation, _ = episodes.reset(range(count), rngs, options)
        for _ in periods_of(episodes, [policy] * count, observation):
            pass
        rows += [{"policy": name, "context": k, "reward": episodes.tally["reward"][k]} for k in range(count)]
    return pd.DataFrame(rows)


def compared(table: pd.DataFrame, simulated: pd.DataFrame) -> tuple[pd.DataFrame, Mapping[str, float]]:
    """A row a policy with mean rewards in the map and simulated, and how well their order agrees (Kendall's tau)."""
    rows = []
    for name, part in table.groupby("policy", sort=False):
        true = simulated[simulated["policy"] == name].groupby("context")["reward"].mean()
        own = part.set_index("context")["reward"]
        both = own.index.intersection(true.index)
        error = mean_interval((own[both] - true[both]).to_numpy())
        columns = {"error": error.mean, "error_low": error.low, "error_high": error.high}
        rows.append({"policy": name, "map": own[both].mean(), "simulated": true[both].mean(), **columns})
    comparison = pd.DataFrame(rows)
    tau = float(kendalltau(comparison["map"], comparison["simulated"]).statistic)
    return comparison, {"tau": tau, "tubes": float(len(both))}


def run_world(limit: int, simulated: Path, output: Path) -> pd.DataFrame:
    """Record, find the noise, compare; writes map-world.json and map-world.csv.

    Args:
        limit: training tubes that are recorded, the first, which are balanced.
        simulated: episodes of an evaluation at ``fast`` on the test tubes (episodes.csv).
        output: folder.

    Raises:
        FileError: ``simulated`` is no such table; nothing was recorded.
    """
    truth = read_csv(simulated, {"policy": "name", "context": "count", "reward": "number"})
    rows = record_insertions(limit)
    noise = noise_of(rows, stored_map())
    path = output / STORED.name
    record = {"noise": noise.model_dump(), "tubes": limit, "periods": len(rows), "provenance": provenance()}
    write_json(path, record)
    known = tuple(name for name in POLICIES if name in set(truth["policy"].str.split("@").str[0]))
    truth = truth[~truth["policy"].str.contains("@") | truth["policy"].str.endswith("@0")]
    truth = truth.assign(policy=truth["policy"].str.split("@").str[0])
    summary, agreement = compared(rewards_in_the_map(known, noise), truth)
    write_json(path, record | {"agreement": dict(agreement)})
    write_atomically(output / "map-world.csv", summary.to_csv(index=False, float_format="%.5g"))
    return summary


HEADER: Final = ("policy", "in the map", "simulated", "difference")


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a policy."""
    return [
        (
            str(row["policy"]), f"{row['map']:.1f}", f"{row['simulated']:.1f}",
            f"{row['error']:+.1f} [{row['error_low']:.1f}, {row['error_high']:.1f}]",
        )
        for row in summary.to_dict("records")
    ]  # fmt: skip
