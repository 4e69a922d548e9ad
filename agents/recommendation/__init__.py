"""Studies of recommended schedules, and the search for round-trip schedules."""
