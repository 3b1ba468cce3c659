"""Problem files: the tables of a TOML document, read into a `Problem` and written from one."""
