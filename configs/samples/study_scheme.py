"""The stage's policies in a helix of 8 m, with the study's scheme, too; for ``results study-scheme --confirm``."""

import sys
from pathlib import Path

from agents.evaluation.fidelity_check import Checks
from agents.evaluation.report import evaluate, plan_of
from agents.policies.places import place_at

HELIX = 8.0  # [m]
AGENT = "student=results/agents/student/seed-0/agent.npz"
POLICIES = ("tension-scheduled", "adaptive", "best-schedule-by-diameter", AGENT)


def main() -> None:
    """Evaluate them in the first test tube, cut short: all the code of the stage, in minutes."""
    place = place_at(None, "test", 1)
    tube = place.config.scene.tube.model_copy(update={"helix_length": HELIX})
    scene = place.config.scene.model_copy(update={"tube": tube, "carrier_length": HELIX / 2.0})
    place = place._replace(config=place.config.model_copy(update={"scene": scene}))
    evaluate(plan_of(POLICIES, place, 1, "fast"), Path(sys.argv[1]), Checks("acting", "study"))


if __name__ == "__main__":
    main()
