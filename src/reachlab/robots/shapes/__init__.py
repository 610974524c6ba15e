"""Capsules around the links, and how near they are to what they must not touch."""
