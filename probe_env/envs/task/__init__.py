"""The control task: actions, observations, rewards, costs and endings of N probes; no simulator."""
