"""What problems come to, number by number, as it was recorded: a redesign of the code in between changes none of it.

`python -m tests.frozen` records it anew, where a change of behaviour is meant.
"""
