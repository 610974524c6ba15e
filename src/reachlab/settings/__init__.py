"""What can be set: configurations, presets, and input that is refused."""
