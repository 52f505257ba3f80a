"""`python -m gn0` is `gn0`."""

from gn0.cli.main import entry

if __name__ == "__main__":
    entry()
