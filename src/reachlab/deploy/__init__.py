"""Out to a robot: export of a run, a controller that needs NumPy alone, its check against a plant, a node for ROS 2."""
