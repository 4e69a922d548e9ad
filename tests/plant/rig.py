"""Logs of a simulated rig: an operator feeds by hand and stops now and then.

``python tests/plant/rig.py`` makes ``configs/logs/example-rig.csv`` again.
"""

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from probe_agents.studies.response import RECORDED
from probe_env import Context, Fidelity, Plant
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.fidelity import resolve_fidelity

FILE = Path(__file__).parents[2] / "configs" / "logs" / "example-rig.csv"
COLUMNS = ("time", "inserted_length", "feed_speed", "air_supply", *RECORDED)
HALT = 20.0
"""Time of a stop [s]."""
LENGTHS, FEEDS, AIRS = (5.0, 15.0, 25.0, 40.0), (0.35, 0.3, 0.16, 0.1), (63.0, 76.0, 90.0, 110.0)
"""Lengths [m], feeds [m/s] and air supplies [m3/h] of the operator."""


def rig_logs(
    contexts: Sequence[Context],
    stops: Sequence[Mapping[float, float]],
    plant: Plant,
    fidelity: str | Fidelity,
    seed: int,
) -> list[FloatArray]:
    """Logs (rows, ``COLUMNS``) of insertions, with the noise of gauges, twice a second; air supply in m3/h.

    ``stops``: for each insertion a feed [m/s] by the inserted length [m] at which the operator sets it for ``HALT``.
    """
    config = plant.configured(changes={"period": 0.5}).model_copy(update={"feed_speeds": (1e-6, 0.4)})
    count, rng = len(contexts), np.random.default_rng(seed)
    episodes = Episodes(count, config, fidelity=resolve_fidelity(fidelity, config.scene))
    rngs = {k: np.random.default_rng([seed, k]) for k in range(count)}
    _, infos = episodes.reset(range(count), rngs, {k: {"context": c} for k, c in enumerate(contexts)})
    length, time = np.array([infos[k]["inserted_length"] for k in range(count)]), 0.0
    left, slow, until = [dict(each) for each in stops], np.zeros(count), np.zeros(count)
    rows: list[list[FloatArray]] = [[] for _ in range(count)]
    while (active := episodes.running.copy()).any():
        for k in range(count):
            for at in [at for at in left[k] if at <= length[k]]:
                slow[k], until[k] = left[k].pop(at), time + HALT
        feed = np.where(time < until, slow, np.interp(length, LENGTHS, FEEDS))
        episodes.step(config.actions(feed, np.interp(length, LENGTHS, AIRS) / 3600.0), active)
        window = episodes.window
        assert window is not None
        length, time = np.where(active, window.inserted_length, length), time + config.period
        channels = [np.hypot(window.statistics[name], floor) for name, floor in RECORDED.values()]
        channels[0] = window.statistics["tension_mean_n"] * (1.0 + 0.02 * rng.normal(size=count))
        channels[1:] = [values * np.exp(0.05 * rng.normal(size=count)) for values in channels[1:]]
        encoder, air = length + 2e-4 * rng.normal(size=count), 3600.0 * window.air_supply_rate
        shown = (encoder, window.feed_speed, air + 0.3 * rng.normal(size=count), *channels)
        for k in np.flatnonzero(active).tolist():
            rows[k].append(np.array([time, *(values[k] for values in shown)]))
    return [np.array(each) for each in rows]


def write_log(path: Path, log: FloatArray) -> Path:
    """Write a log with the names and units that ``probe-env log`` writes."""
    head = "time [s],inserted_length [m],feed_speed [m/s],air_supply [m3/h],root_tension [N],"
    head += "radial_acceleration_rms [m/s2],axial_acceleration_rms [m/s2],rf_noise_rms [m]"
    np.savetxt(path, log, fmt="%.6g", delimiter=",", header=head, comments="")
    return path


def main() -> None:
    """Write the shipped log as a German rig would: semicolons, decimal commas, a comment, a remark."""
    (log,) = rig_logs([Context(friction=0.2)], [{30.0: 0.0}], Plant(), "standard", 1)
    start = datetime(2024, 5, 14, 9, 31, 5, 200_000)
    rows = ["# Prüfstand 2, Sonde 7, Einschub von Hand gesteuert"]
    rows += ["Zeitstempel;Weg [m];Vorschub [mm/s];Luft [m³/h];Zugkraft [N];Rauschen [µm];Bemerkung"]
    halt = int(np.flatnonzero(log[:, 1] >= 30.0)[0]) + 1
    for k, (time, length, feed, air, tension, _, _, noise) in enumerate(log):
        cells = f"{length:.4f}", f"{1e3 * feed:.1f}", f"{air:.1f}", f"{tension:.2f}", f"{1e6 * noise:.1f}"
        stamp = (start + timedelta(seconds=float(time))).isoformat(timespec="milliseconds")
        rows.append(";".join((stamp, *(cell.replace(".", ",") for cell in cells), "Halt" if k == halt else "")))
    FILE.write_bytes(("\r\n".join(rows) + "\r\n").encode("cp1252"))


if __name__ == "__main__":
    main()
