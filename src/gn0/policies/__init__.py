"""Policies that ship with GN0."""
