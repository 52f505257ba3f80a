"""Print the lowest versions that pyproject allows, as constraints for pip."""

import re
import sys
import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]
extras = project["optional-dependencies"]
for line in [*project["dependencies"], *extras["view"], *extras["dev"]]:
    found = re.match(r"([A-Za-z0-9_.-]+)>=([0-9.]+)", line)
    if found and not re.match(r"ruff|mypy|build|twine|pytest|coverage|nvidia", found[1]):
        sys.stdout.write(f"{found[1]}=={found[2]}\n")
