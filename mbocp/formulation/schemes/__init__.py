"""One class for each family of schemes and coordinates, and the equations of its steps."""
