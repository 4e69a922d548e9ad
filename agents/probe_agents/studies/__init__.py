"""Studies: policies, cases and varied fields in a TOML file; episodes, paired differences and a figure in a folder."""
