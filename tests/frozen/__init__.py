"""What problems come to, number by number, as recorded: a redesign in between changes none of it.

`python -m tests.frozen` records it anew, where a change of behaviour is meant.
"""
