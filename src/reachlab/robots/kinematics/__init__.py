"""The chain of joints: its frames, its inverse, and its limits."""
