"""What is asked of an arm: goals, observations, actions, rewards, and when an episode ends."""
