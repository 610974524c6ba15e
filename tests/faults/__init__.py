"""Faults, made on purpose; `make trust` tries them in bulk."""
