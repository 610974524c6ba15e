"""What is kept: the run directory and its files."""
