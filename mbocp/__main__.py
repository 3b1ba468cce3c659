"""`python -m mbocp` is the command line."""

from mbocp.cli import main

if __name__ == "__main__":
    main()
