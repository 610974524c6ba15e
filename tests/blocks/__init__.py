"""Commands of README and docs, run as they stand with little to compute; see `make docs-blocks`."""
