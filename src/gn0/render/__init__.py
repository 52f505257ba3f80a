"""One renderer protocol and its backends."""
