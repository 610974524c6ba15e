"""The viewer in a real browser: the driver, dragging the target by the mouse, and measurements."""
