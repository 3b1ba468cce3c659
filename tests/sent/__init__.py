"""Motions as they are sent: written, read back without mbocp, and compared with the exact optimum of joints."""
