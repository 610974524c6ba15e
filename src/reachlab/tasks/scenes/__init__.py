"""What stands beside the arm in task `clutter`: random balls, capsules and boxes, or furniture by name."""
