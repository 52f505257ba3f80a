"""GN0: navigation data, simulator, benchmark and policies in 3D Gaussian Splatting scenes.

The package root stays light: its names are imported on first use, so `import gn0` costs almost
nothing and never touches Numba, PyArrow or a renderer.
"""

from gn0.namespace import open_namespace

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
