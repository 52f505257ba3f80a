"""Bare captures: a cloud of splats and nothing else becomes a scene to navigate."""
