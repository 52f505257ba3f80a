"""Policies that ship with GN0, and those behind a socket."""

from gn0.namespace import open_namespace

__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
