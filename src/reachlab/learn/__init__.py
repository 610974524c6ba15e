"""How a policy is learnt: rollouts, PPO, DAgger and the loop around them."""
