"""Suites of episodes: their folders, how they are made and imported, what may be told in them."""
