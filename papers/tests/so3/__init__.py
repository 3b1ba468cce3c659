"""Tests of the second paper."""
