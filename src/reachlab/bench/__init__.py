"""What is measured on this machine, a file a suite."""
