"""Episodes: what an agent is asked to do, where, and the reference path."""

from gn0.namespace import open_namespace

__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
