"""Who acts: the trained policy, and baselines."""
