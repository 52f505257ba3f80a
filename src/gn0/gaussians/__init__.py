"""Splats and all their file formats, read safely."""
