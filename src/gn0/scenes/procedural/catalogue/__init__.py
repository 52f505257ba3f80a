"""Things that rooms are furnished with: a file or folder a kind, a function a thing."""
