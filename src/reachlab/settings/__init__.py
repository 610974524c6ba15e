"""Settings: configurations, presets, and input that is refused."""
