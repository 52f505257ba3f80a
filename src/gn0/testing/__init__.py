"""Checks that your plug-in can be run against, and small scenes to run it in."""

from gn0.namespace import open_namespace

__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
