"""Splats and every file format of theirs, read safely."""
