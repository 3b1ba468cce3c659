"""What problems add to a plain formulation: states, controls, rows, parameters, each in a file of its own."""
