"""Print pyproject.toml's build requirements, one a line, for pip."""

from pathlib import Path

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    from pip._vendor import tomli as tomllib

print("\n".join(tomllib.loads(Path("pyproject.toml").read_text())["build-system"]["requires"]))
