"""Pairs of policies by the depth that each finds: against curves whose depths are known, and signs that are."""

import numpy as np
import pandas as pd
import pytest
from scipy.special import ndtr

from agents.detection.pairs import pairs_of, signs, survival
from agents.rollouts.depths import difference_of_a90
from probe_env.inspection.detection import DEPTHS
from probe_env.inspection.tally import POD_NAMES

Z, QUANTILE = 4.6, 1.2816


def curves(snr):
    """(n, d) Gaussian curves of tubes with this signal-to-noise (n,) of the 20 % groove."""
    return ndtr(np.asarray(snr)[:, None] * DEPTHS / 0.2 - Z)


def episodes(**snr):
    """A table of policies, each with its signal-to-noise by tube."""
    parts = []
    for policy, values in snr.items():
        table = pd.DataFrame(curves(values), columns=list(POD_NAMES))
        parts.append(table.assign(policy=policy, context=range(len(values)), seed=0))
    return pd.concat(parts, ignore_index=True)


def test_the_difference_of_depths_is_that_of_the_closed_form():
    """Tubes alike: a90 is 20 % (z + 1.28) / SNR, and nothing scatters."""
    apart = difference_of_a90(curves([5.0] * 8), curves([8.0] * 8))
    assert apart.mean == pytest.approx(20.0 * (Z + QUANTILE) * (1 / 5.0 - 1 / 8.0), rel=1e-4)
    assert apart.low == pytest.approx(apart.mean)
    assert apart.high == pytest.approx(apart.mean)


def test_tubes_are_drawn_anew_together():
    """Tubes differ by a factor of two, and one policy is 1 % better in each: paired it is clear, unpaired it is not."""
    snr = np.linspace(4.0, 8.0, 24)
    paired = difference_of_a90(curves(snr), curves(1.01 * snr))
    assert 0.0 < paired.low < paired.mean < paired.high < 1.0
    crossed = difference_of_a90(curves(snr), curves(1.01 * snr[::-1]))
    assert crossed.low < 0.0 < crossed.high
    assert crossed.mean == pytest.approx(paired.mean)


def test_one_tube_tells_no_policies_apart():
    """However far: nothing is known of the scatter between tubes."""
    pairs = pairs_of({"usual": episodes(a=[5.0], b=[8.0])})
    assert pairs["difference"].item() > 1.0
    assert pairs[["low", "high"]].isna().all(axis=None)
    assert signs(pairs)["usual"].tolist() == [0]
    assert survival(pairs, "usual").startswith("Of 1 pairs of policies 0 are clearly apart")
    assert survival(pairs, "usual").endswith("0 turn round.")


def test_a_row_for_every_pair_and_anchor():
    alike, table = episodes(a=[5.0] * 4, b=[5.0] * 4, c=[8.0] * 4), episodes(a=[4.0] * 4, b=[5.0] * 4, c=[6.0] * 4)
    pairs = pairs_of({"as they are": alike, "halved": table})
    assert len(pairs) == 6
    shown = signs(pairs)
    assert shown.loc[("a", "b")].to_dict() == {"as they are": 0, "halved": 1}
    assert shown.loc[("a", "c")].to_dict() == {"as they are": 1, "halved": 1}
    swapped = pairs_of({"as they are": episodes(a=[8.0] * 4, b=[5.0] * 4)})
    assert signs(swapped)["as they are"].tolist() == [-1]


def test_what_survives_is_counted_and_what_turns_is_named():
    ends = {1: (0.5, 2.0), 0: (-1.0, 1.0), -1: (-2.0, -0.5)}
    known = {
        ("a", "b"): (1, 1, 1),  # stays
        ("a", "c"): (-1, -1, 0),  # is not told apart with one
        ("a", "d"): (0, 1, -1),  # was not told apart
        ("b", "c"): (1, -1, 0),  # turns
        ("b", "d"): (-1, 1, 1),
    }
    rows = [
        (*pair, what, sum(ends[sign]) / 2, *ends[sign])
        for pair, expected in known.items()
        for what, sign in zip(("usual", "less", "more"), expected, strict=True)
    ]
    pairs = pd.DataFrame(rows, columns=["first", "second", "anchors", "difference", "low", "high"])
    assert {pair: tuple(row) for pair, row in zip(signs(pairs).index, signs(pairs).to_numpy(), strict=True)} == known
    assert survival(pairs, "usual") == (
        "Of 5 pairs of policies 4 are clearly apart with the anchors usual (95 % intervals, paired over tubes). Of"
        " these 1 are so with every one of them, 1 are not told apart with some; 2 turn round: b and c (less);"
        " b and d (less, more)."
    )
