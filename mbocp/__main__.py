"""`python -m mbocp` is the command line."""

from mbocp.cli import script

if __name__ == "__main__":
    script()
