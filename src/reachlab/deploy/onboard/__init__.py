"""What runs on a robot's computer, with NumPy and the standard library alone.

An export joins these files into one, `controller.py`; see `reachlab.deploy.bundle`.
"""
