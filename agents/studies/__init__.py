"""Studies of the simulator and of policies, each stored as tables and figures in a folder."""
