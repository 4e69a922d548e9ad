"""What the page on both passes says of a search."""

import pandas as pd
import pytest

from agents.pages import passes
from agents.recommendation.both_ways import COLUMNS

TRIALS = pd.DataFrame(
    [(0.4, 63.0, 0.4, 63.0, 20.0), (0.4, 48.0, 0.4, 101.0, 21.0), (0.4, 48.0, 0.4, 101.0, 21.0),
     (0.4, 50.0, 0.4, 98.0, 20.5), (0.2, 60.0, 0.2, 60.0, 5.0)],
    columns=[*COLUMNS, "reward"],
)  # fmt: skip


@pytest.mark.parametrize(("rows", "said"), [(5, "1 other comes within 1."), (1, "0 others come within 1.")])
def test_a_schedule_is_counted_once_and_the_best_not_as_another(rows, said):
    assert passes._as_good(TRIALS.head(rows)) == said


@pytest.mark.parametrize(
    ("best", "said"),
    [
        (1, "More than the first of them earns, paired: 1 [0.5, 1.5] in 24 validation tubes."),
        (0, "The best is the first of them."),
    ],
)
def test_a_search_that_found_nothing_better_says_so(best, said):
    searched = {"schedule": TRIALS.iloc[best][list(COLUMNS)].to_dict(), "validation_tubes": 24}
    searched["gain"] = {"mean": 1.0, "low": 0.5, "high": 1.5}
    assert passes._over_the_first(TRIALS, searched) == said
