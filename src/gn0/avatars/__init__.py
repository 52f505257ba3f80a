"""People: bodies that can be dressed and moved, as Gaussians; does not know renderers."""

from gn0.namespace import open_namespace

__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
