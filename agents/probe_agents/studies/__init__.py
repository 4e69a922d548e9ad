"""Studies: policies, cases and varied fields in a TOML file; episodes, paired differences and a figure in a folder."""

from typing import TYPE_CHECKING

from probe_env.lazy import lazy

if TYPE_CHECKING:
    from probe_agents.studies.run import expand, run_study
    from probe_agents.studies.spec import Study

__all__ = [
    "Study", "expand", "run_study",
]  # fmt: skip
__getattr__, __dir__ = lazy(__name__)
