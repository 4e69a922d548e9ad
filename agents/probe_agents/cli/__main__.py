"""``python -m probe_agents.cli``."""

import sys

from probe_agents.cli import main

sys.exit(main())
