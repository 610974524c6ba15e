"""Ways among bodies: where an arm is free, a path by random sampling, and the motion along it."""
