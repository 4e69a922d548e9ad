"""What is asked of the probe: actions enter, observations, rewards and KPIs leave.

The task has all rules and no simulator; episodes put both together, once for one environment and for many; the rest is
glue to Gymnasium. Imports the physics, scenes, designs, schedules and fidelities; matplotlib in ``pictures`` alone.
"""
