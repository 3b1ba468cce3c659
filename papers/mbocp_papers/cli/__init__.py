"""`mbocp paper`: a command that this package adds to mbocp's."""
