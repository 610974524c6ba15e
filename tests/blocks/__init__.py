"""The commands of README and docs are run as they stand, in one folder, with little to compute; see `make docs-blocks`."""
