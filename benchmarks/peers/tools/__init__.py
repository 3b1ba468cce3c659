"""One module a solver: `run(task, repeats, folder)` gives a `Run`."""
