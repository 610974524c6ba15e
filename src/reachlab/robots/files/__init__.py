"""Model files: MJCF and URDF with what they name, read safely."""
