"""Terminal: names, tables, messages and progress. Imports no other part of ``probe_agents``."""
