"""Decide and judge: policies, training, evaluation, designs, studies and the commands, above ``probe_env``."""
