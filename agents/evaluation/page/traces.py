"""What the interactive pictures are drawn from: feed, air and vibration a metre of every policy in every tube."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.colors import to_hex

from agents.evaluation.page.verdict import ranking
from agents.records.drawing import colours

MOST_METRES: Final = 60_000
"""Of all traces of a page: with more, metres are gathered, so that no page grows beyond a few megabytes."""
FIELDS: Final = {"feed_speed": 1e4, "air_supply_rate": 3.6e4, "radial_rms_m": 1e7}
"""Field -> its unit on the page: 0.1 mm/s, 0.1 m3/h and 0.1 um, whole numbers."""


def traces(
    table: pd.DataFrame, profile: pd.DataFrame, shown: Collection[str], limit_mm: float | None
) -> dict[str, Any]:
    """JSON-ready traces; of several seeds the first.

    Args:
        table: episodes.
        profile: of them, a row a metre.
        shown: policies that are drawn before anybody chooses.
        limit_mm: of the radial rms [mm]; None: the limit is one of another measure.
    """
    order = list(dict.fromkeys(table["policy"]))  # the colours of the other pictures
    first = profile.drop_duplicates(["policy", "context", "seed", "agent"])[["policy", "context", "seed", "agent"]]
    first = first.sort_values(["agent", "seed"], kind="stable").drop_duplicates(["policy", "context"])
    metres = profile.merge(first).dropna(subset=["inserted_length"])
    width = 1 + len(metres) // MOST_METRES
    binned = metres.assign(
        metre=(metres["inserted_length"] // width) * width + 0.5 * width, radial_rms_m=metres["radial_rms_m"] ** 2
    )
    means = binned.groupby(["policy", "context", "metre"], as_index=False)[list(FIELDS)].mean()
    means["radial_rms_m"] **= 0.5
    episodes = {place: rows.set_index("metre") for place, rows in means.groupby(["policy", "context"])}
    grid = sorted(map(float, binned["metre"].unique()))
    tubes: list[dict[Any, Any]] = table.drop_duplicates("context").sort_values("context").to_dict("records")
    worst = table.loc[table.groupby("policy")["reward"].idxmin()].set_index("policy")["context"].to_dict()
    palette = [to_hex(colour) for colour in colours()]
    return {
        "metres": grid,
        "limit": limit_mm,
        "tubes": [{"number": tube["context"], "text": _label(tube)} for tube in tubes],
        "policies": [
            {
                "name": policy,
                "colour": palette[order.index(policy) % len(palette)],
                "shown": policy in shown,
                "worst": worst[policy],
                "tubes": [_columns(episodes.get((policy, tube["context"])), grid) for tube in tubes],
            }
            for policy in ranking(table)
        ],
    }  # fmt: skip


def _label(tube: Mapping[str, Any]) -> str:
    if tube["helix_diameter"] <= 0.0:
        return ""
    return f"helix {tube['helix_diameter']:g} m, friction {tube['friction']:.3f}"


def _columns(episode: pd.DataFrame | None, grid: list[float]) -> list[list[int | None]]:
    """Feed, air and vibration on the grid, whole numbers; None where there is no metre. Empty: nothing was fed."""
    if episode is None:
        return []
    rows = episode.reindex(grid)
    scaled = (rows[name].to_numpy(dtype=float) * factor for name, factor in FIELDS.items())
    return [[round(v) if np.isfinite(v) else None for v in values.tolist()] for values in scaled]
