"""Behaviour printed: functions that JAX traces, as straight code in Python, C and JavaScript."""
