"""From names, files and tables to a `Robot`."""
