"""Motions as they are sent: written, read back without mbocp, compared with the exact optimum of joints."""
