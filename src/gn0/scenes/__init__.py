"""Scenes and splats: loaded, generated, made from a capture, saved in one folder."""

from gn0.namespace import open_namespace

__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
