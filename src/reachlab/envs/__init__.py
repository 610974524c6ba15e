"""Episodes: a simulator, a task and a clock as one environment."""
