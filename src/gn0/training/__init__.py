"""Training of policies by torch (extra `train`): streams of samples, stages, runs that resume."""

from gn0.namespace import open_namespace

__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
