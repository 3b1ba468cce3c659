"""Readers: each makes a `Description` of a robot from one kind of source."""
